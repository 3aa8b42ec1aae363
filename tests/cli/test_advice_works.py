"""What error messages propose, followed to the letter on the input that caused them."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import camera_logs
import cv2
import layouts
import pytest
from typer.testing import CliRunner

from vo.cli.app import app
from vo.recordings.formats.messages import PoseMessage


def vo(text: str, *more: str) -> tuple[int, str]:
    """Exit status and output of a command; a traceback is an error of the test."""
    result = CliRunner().invoke(app, [*shlex.split(text), *more])
    assert result.exception is None or isinstance(result.exception, SystemExit), text
    return result.exit_code, result.output


def _replace(name: str, before: str, after: str) -> Callable[[], None]:
    def edit() -> None:
        file = Path(name)
        text = file.read_text("utf-8")
        assert before in text
        file.write_text(text.replace(before, after), encoding="utf-8")

    return edit


def _add(name: str, line: str) -> Callable[[], None]:
    def edit() -> None:
        with Path(name).open("a", encoding="utf-8") as file:
            file.write(f"{line}\n")

    return edit


def _pair() -> None:
    layouts.write_folder(Path("walk"))


def _one_camera(calibration: str = layouts.CALIBRATION) -> None:
    for i in range(layouts.COUNT):
        layouts.write_image(Path(f"walk/{i}.png"), layouts.image(i))
    layouts.write_text(Path("walk/calibration.yaml"), calibration.replace("baseline_m: 0.12\n", ""))


def _opencv(lines: str) -> Callable[[], None]:
    return lambda: _one_camera(lines)


def _log(*topics: str, calibrated: bool = True) -> Callable[[], None]:
    def write() -> None:
        cameras = [camera_logs.images(topic, topic[1:]) for topic in topics]
        info = [camera_logs.calibration(f"{topic}_info", topic[1:]) for topic in topics]
        camera_logs.log(Path(), *cameras, *(info if calibrated else []))

    return write


def _log_with_poses() -> None:
    poses = [
        (topic, PoseMessage(stamp, "world", pose))
        for topic in ("/a", "/b")
        for stamp, pose in zip(layouts.STAMPS_NS, layouts.truth(), strict=True)
    ]
    camera_logs.log(Path(), poses)
    layouts.write_text(Path("a.tum"), layouts.tum_text(layouts.truth()))


def _calibration_of_another_name() -> None:
    _one_camera()
    Path("walk/calibration.yaml").rename("walk/camera.yaml")


def _resized() -> None:
    _one_camera(layouts.CALIBRATION)
    for i in range(layouts.COUNT):
        layouts.write_image(Path(f"walk/{i}.png"), cv2.resize(layouts.image(i), (32, 24)))


def _resized_calibration() -> None:
    values = {"intrinsics": [v / 2 for v in layouts.INTRINSICS], "resolution": [32, 24]}
    Path("half.yaml").write_text(json.dumps({"cam0": values}), encoding="utf-8")


def _late() -> None:
    for i, stamp in enumerate(layouts.STAMPS_NS):
        layouts.write_image(Path(f"walk/left/{stamp}.png"), layouts.image(i))
        late = stamp + 1_234_567_890 + (i % 3) * 9_000_000
        layouts.write_image(Path(f"walk/right/{late}.png"), layouts.image(i, right=True))
    layouts.write_text(Path("walk/calibration.yaml"), layouts.CALIBRATION)


def _nerf_outside() -> None:
    layouts.write_nerf(Path("scene"))
    Path("scene/images").rename("images")
    _replace("scene/transforms.json", "./images", "../images")()


def _straight() -> None:
    rows = "".join(f"{i} {i} 0 0 0 0 0 1\n" for i in range(2))
    for name in ("a.tum", "b.tum"):
        layouts.write_text(Path(name), rows)


def _apart() -> None:
    rows = [f"{i * 0.1:.3f} {i} {i * i} 0 0 0 0 1\n" for i in range(9)]
    layouts.write_text(Path("a.tum"), "".join(rows))
    layouts.write_text(Path("b.tum"), "".join(f"{float(r[:5]) + 0.03:.3f}{r[5:]}" for r in rows))


TRUTH = layouts.tum_text(layouts.truth())
OPENCV = "image_width: 64\nimage_height: 48\nfx: 50\nfy: 51\ncx: 31.5\ncy: 23.5\n"
ZEROS = "distortion_coefficients: [0, 0, 0, 0, 0]\n"
MATRIX = "camera_matrix: {{rows: 3, cols: 3, data: [{}]}}\n"
BY_ROWS, BY_COLUMNS = "50, 0, 31.5, 0, 51, 23.5, 0, 0, 1", "50, 0, 0, 0, 51, 0, 31.5, 23.5, 1"
SIZE = "image_width: 64\nimage_height: 48\n"


class Row(NamedTuple):
    """An input, a command that refuses it, what the message proposes, and what is done.

    Attributes:
        advice: pattern in the message; its groups, if any, are words that are added.
        edit: what is changed, where the advice is no option.
        command: the command that follows, if it is another one.
    """

    make: Callable[[], None]
    refused: str
    advice: str
    edit: Callable[[], None] | None = None
    command: str = ""


ROWS = {
    "several cameras": Row(
        _log("/a", "/b", "/c"), "info log.mcap", r"Choose with (--topic \S+ --topic [^\s,]+),"
    ),
    "one of several": Row(_log("/a", "/b", "/c"), "info log.mcap", r"or one with (--topic \S+)"),
    "a log without calibration": Row(
        _log("/a", "/b", calibrated=False),
        "info log.mcap --topic left=/a --topic right=/b",
        r"give a file with (--calibration) FILE",
        lambda: _one_camera(),
        "info log.mcap --calibration walk/calibration.yaml",
    ),
    "two topics without roles": Row(
        _log("/a", "/b", calibrated=False),
        "info log.mcap --topic /a --topic /b",
        r"try: vo run log.mcap -o out/log (--topic /a --topic /b) --calibration",
        _one_camera,
        "info log.mcap --topic /a --topic /b --calibration walk/calibration.yaml",
    ),
    "several places of poses": Row(
        _log_with_poses, "eval a.tum log.mcap", r"choose the truth with (--topic truth=\S+)"
    ),
    "no right camera": Row(
        _one_camera, "convert walk out --mode stereo", "use (--mode mono)", None,
        "convert walk out --mode mono",
    ),
    "a calibration of another name": Row(
        _calibration_of_another_name, "info walk", r"give (--calibration \S+?)(?=[;\s]|$)"
    ),
    "no distortion": Row(
        _opencv(OPENCV), "info walk", r"add distortion_coefficients: \[k1, k2, p1, p2, k3\]",
        _add("walk/calibration.yaml", ZEROS),
    ),
    "no distortion in images": Row(
        _opencv(OPENCV), "info walk", r"or \[\] if the images have no distortion",
        _add("walk/calibration.yaml", "distortion_coefficients: []"),
    ),
    "a fisheye lens": Row(
        _opencv(OPENCV + "k1: 0.01\nk2: 0.0\nk3: 0.0\nk4: 0.0\n"), "info walk",
        "add distortion_model: equidistant",
        _add("walk/calibration.yaml", "distortion_model: equidistant"),
    ),
    "a transposed matrix": Row(
        _opencv(SIZE + MATRIX.format(BY_COLUMNS) + ZEROS), "info walk",
        "write it row by row",
        _replace("walk/calibration.yaml", BY_COLUMNS, BY_ROWS),
    ),
    "resized images": Row(
        _resized, "info walk",
        "with (--calibration) FILE .for resized images, scale its fx, fy, cx and cy as well",
        _resized_calibration, "info walk --calibration half.yaml",
    ),
    "a nerf outside": Row(
        _nerf_outside, "info scene", r"run on the folder of the images with (--calibration \S+)",
        None, "info images --calibration scene/transforms.json",
    ),
    "a folder that is there": Row(
        lambda: (_pair(), vo("convert walk out")), "convert walk out",
        "or remove it first", lambda: shutil.rmtree("out"),
    ),
    "a format without missing images": Row(
        lambda: (_pair(), Path("walk/right/frame9.png").unlink()),
        "convert walk out --to kitti", "use --to euroc, or --mode mono", None,
        "convert walk out --to kitti --mode mono",
    ),
    "no depth": Row(
        _one_camera, "convert walk out --to tum", "use (--to euroc)", None,
        "convert walk out --to euroc",
    ),
    "two poses": Row(_straight, "eval a.tum b.tum", "or use (--align none)"),
    "stamps apart": Row(
        _apart, "eval a.tum b.tum", "or a larger (--tolerance)", None,
        "eval a.tum b.tum --tolerance 0.04",
    ),
    "no loops and a map": Row(
        _pair, "run walk -o out --no-loops --save-map a.vomap", "leave out --no-loops", None,
        "run walk -o out --save-map a.vomap",
    ),
    "localize without a map": Row(
        _pair, "run walk -o out --localize", r"give it by (--map) FILE",
        lambda: vo("run walk -o first --save-map a.vomap"),
        "run walk -o out --localize --map a.vomap",
    ),
    "a descriptor of another detector": Row(
        _one_camera,
        "features walk --set features.detector=fast --set features.descriptor=akaze",
        "try rootsift or rbrief", None,
        "features walk --set features.detector=fast --set features.descriptor=rootsift",
    ),
    "positions of another clock": Row(
        lambda: (_one_camera(), layouts.write_text(Path("a.tum"), TRUTH)),
        "run walk -o out --mode mono --scale-from a.tum",
        r"by (--scale-offset) .starting together: (\S+)\)",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ROWS)
def test_advice_of_errors(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "4000")
    row = ROWS[name]
    row.make()
    status, output = vo(row.refused)
    found = re.search(row.advice, " ".join(output.split()))
    assert status == 1 and found is not None, output
    if row.edit is not None:
        row.edit()
    words = shlex.split(" ".join(found.groups())) if not row.command else []
    status, followed = vo(row.command or row.refused, *words)
    refused = re.findall(r"^(?:error|problem): (.*)", output, re.MULTILINE)
    again = re.findall(r"^(?:error|problem): (.*)", followed, re.MULTILINE)
    assert not set(refused) & set(again), followed
    assert status in (0, 3) or "no path" in followed, followed
