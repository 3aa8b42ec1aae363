"""A model in a recording: it stays where it is while the camera moves."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

import vo
from vo.base.config import load_config
from vo.base.errors import ConfigError, SourceError
from vo.base.geometry import cameras
from vo.base.geometry.transforms import inverse
from vo.cli.app import app
from vo.runs.run_recording import run

FRAMES = 8


@pytest.fixture(scope="module")
def finished(synthetic_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    run(synthetic_stereo, folder / "out", config=load_config("fast"), end=FRAMES)
    return folder / "out"


def test_the_model_is_drawn_at_its_place_in_each_frame(finished: Path, tmp_path: Path) -> None:
    at = (0.05, 0.15, 2.0)
    options = vo.RenderOptions(at=at, size=0.2)
    done = vo.render(finished, tmp_path / "a.mp4", options=options)
    assert (done.frames, done.with_model, done.at, done.unit) == (FRAMES, FRAMES, at, "m")
    video = cv2.VideoCapture(str(tmp_path / "a.mp4"))
    assert int(video.get(cv2.CAP_PROP_FRAME_COUNT)) == FRAMES
    video.release()
    recording = vo.open(json.loads((finished / "summary.json").read_text())["source"])
    path = vo.read_trajectory(finished / "trajectory.tum")
    middle = np.array([at]) - (0.0, 0.1, 0.0)
    for number in (0, FRAMES - 1):
        picture = tmp_path / f"{number}.png"
        options = vo.RenderOptions(at=at, size=0.2, frame=number)
        assert vo.render(finished, picture, options=options).frames == 1
        (frame,) = recording.frames(number, number + 1)
        changed = np.abs(cv2.imread(str(picture))[..., 0].astype(int) - frame.image0) > 3
        rows, columns = np.nonzero(changed)
        cam_from_world = inverse(path.world_from_cam[number])
        in_cam = middle @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]
        (u, v), focal = cameras.project(recording.rig.cam0, in_cam)[0], recording.rig.cam0.fx
        reach = 0.13 * focal / in_cam[0, 2]
        assert abs(0.5 * (columns.min() + columns.max()) - u) < reach
        assert abs(0.5 * (rows.min() + rows.max()) - v) < reach
        assert 0.4 * reach < np.ptp(columns) < 2.5 * reach


def test_the_model_stands_upright_where_gravity_is_known(finished: Path, tmp_path: Path) -> None:
    """A pole: along -y of the first camera, and along z in a world whose z axis points up."""
    pole = tmp_path / "pole.obj"
    pole.write_text("v 0 0 0\nv .02 0 0\nv .02 1 .02\nv 0 1 .02\nf 1 2 3\nf 1 3 4\n")
    turned = tmp_path / "upright"
    shutil.copytree(finished, turned)
    summary = json.loads((turned / "summary.json").read_text())
    summary["inertial"] = {"metric_worlds": [0]}
    (turned / "summary.json").write_text(json.dumps(summary))
    heights = []
    for run_folder in (finished, turned):
        picture = tmp_path / f"{run_folder.name}.png"
        options = vo.RenderOptions(at=(0.05, 0.3, 2.0), size=0.6, frame=0)
        vo.render(run_folder, picture, pole, options)
        (frame,) = vo.open(summary["source"]).frames(0, 1)
        changed = np.abs(cv2.imread(str(picture))[..., 0].astype(int) - frame.image0) > 3
        heights.append(int(np.ptp(np.nonzero(changed)[0])))
    assert heights[1] < 0.5 * heights[0]


def test_the_command(finished: Path, tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n")
    words = ["render", str(finished), str(tmp_path / "a.obj"), "-o", str(tmp_path / "a.png")]
    place = ["--in-front", "2:1.5", "--size", "0.4", "--up", "z", "--frame", "2"]
    result = CliRunner().invoke(app, [*words, *place, "--json"])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["frames"] == 1
    default = CliRunner().invoke(app, ["render", str(finished), "-o", str(tmp_path / "b.mp4")])
    assert default.exit_code == 0 and f"frames      {FRAMES}" in default.stdout
    for wrong in (["--at", "1,2"], ["--in-front", "7"]):
        assert CliRunner().invoke(app, [*words, *wrong]).exit_code == 2


def test_what_cannot_be_drawn(finished: Path, tmp_path: Path) -> None:
    cases = [
        (vo.RenderOptions(frame=99), "frame 99 has no pose"),
        (vo.RenderOptions(in_front=(99, 1.0)), "frame 99 has no pose"),
        (vo.RenderOptions(in_front=(0, -1.0)), "cannot be seen"),
        (vo.RenderOptions(size=0.0), "`size` is 0"),
    ]
    for options, message in cases:
        with pytest.raises(ConfigError, match=message):
            vo.render(finished, tmp_path / "a.png", options=options)
    with pytest.raises(ConfigError, match="neither a video"):
        vo.render(finished, tmp_path / "a.txt")
    with pytest.raises(SourceError, match="a.obj does not exist"):
        vo.render(finished, tmp_path / "a.png", tmp_path / "a.obj")
    with pytest.raises(SourceError, match="is not a folder"):
        vo.render(tmp_path / "none", tmp_path / "a.png")


def test_a_model_stands_on_a_marker_of_the_run(finished: Path, tmp_path: Path) -> None:
    """A marker that faces the first camera: the z axis of the model points at the camera."""
    run_folder = tmp_path / "run"
    shutil.copytree(finished, run_folder)
    heading = "segment,id,tx,ty,tz,qx,qy,qz,qw,sigma_m,views,first_frame,last_frame,error,length_m"
    row = "0,3,0.05,0.15,2.0,1,0,0,0,0.001,9,0,8,0.5,0.2"
    (run_folder / "markers.csv").write_text(f"{heading}\n{row}\n", encoding="utf-8")
    picture = tmp_path / "a.png"
    options = vo.RenderOptions(on_marker=3, up="z", frame=0)
    done = vo.render(run_folder, picture, options=options)
    assert done.at == (0.05, 0.15, 2.0) and done.with_model == 1
    path = tmp_path / "b.png"
    result = CliRunner().invoke(
        app, ["render", str(run_folder), "-o", str(path), "--on", "marker:3", "--up", "z"]
    )
    assert result.exit_code == 0, result.output
    assert cv2.imread(str(path)) is not None
    with pytest.raises(ConfigError, match="no marker 4; its markers are 3"):
        vo.render(run_folder, picture, options=vo.RenderOptions(on_marker=4))
    with pytest.raises(SourceError, match="--markers METRES"):
        vo.render(finished, picture, options=vo.RenderOptions(on_marker=3))
