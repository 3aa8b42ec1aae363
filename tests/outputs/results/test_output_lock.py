"""Output folders that are in use by another run or contain other files."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from vo.base.config import load_config
from vo.base.errors import OutputError
from vo.outputs.recorders.exports import Exports
from vo.outputs.results.output_paths import locked_folder
from vo.runs.run_recording import run

FAST = load_config("fast")


def test_two_runs_cannot_write_to_one_folder(tmp_path: Path) -> None:
    code = (
        "import sys\nfrom pathlib import Path\nfrom vo.base.errors import OutputError\n"
        "from vo.outputs.results.output_paths import locked_folder\n"
        "try:\n    with locked_folder(Path(sys.argv[1])): print('locked')\n"
        "except OutputError as error: print(error)\n"
    )

    def other_run() -> str:
        command = [sys.executable, "-c", code, str(tmp_path)]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout

    with locked_folder(tmp_path):
        assert "another run is writing there; choose another `output`" in other_run()
    assert other_run() == "locked\n"


@pytest.mark.parametrize("name", ["config.yaml", "poses.csv", "summary.json"])
def test_other_files_with_names_of_results_are_not_replaced(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("[not a result]\n", encoding="utf-8")
    with (
        pytest.raises(OutputError, match=f"{name} is not a result of an earlier run"),
        locked_folder(tmp_path),
    ):
        pass
    assert (tmp_path / name).read_text(encoding="utf-8") == "[not a result]\n"


def test_a_run_replaces_an_earlier_one_even_if_it_was_killed(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    assert run(synthetic_stereo, tmp_path, config=FAST, end=2).tracked == 2
    assert run(synthetic_stereo, tmp_path, config=FAST, end=2).tracked == 2
    (tmp_path / "summary.json").unlink()
    (tmp_path / "frames.csv").rename(tmp_path / "frames.csv.partial")
    assert run(synthetic_stereo, tmp_path, config=FAST, end=2).tracked == 2


def test_an_earlier_run_is_kept_if_an_output_cannot_be_created(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    run(synthetic_stereo, tmp_path, config=FAST, end=2)
    before = (tmp_path / "trajectory.tum").read_bytes()
    with pytest.raises(OutputError, match="cannot write the recording"):
        run(synthetic_stereo, tmp_path, config=FAST, end=2, rrd=tmp_path)
    assert (tmp_path / "trajectory.tum").read_bytes() == before


def test_a_recording_is_never_overwritten(synthetic_stereo: Path, tmp_path: Path) -> None:
    recording = shutil.copytree(synthetic_stereo, tmp_path / "recording")
    inside = recording / "log.mcap"
    inside.write_bytes(b"data")
    with pytest.raises(OutputError, match="log.mcap is an input and would be replaced"):
        run(recording, tmp_path / "out", config=FAST, exports=Exports(mcap=inside))
    with pytest.raises(OutputError, match="is an input and would be replaced"):
        run(inside, tmp_path / "out", config=FAST, exports=Exports(mcap=inside))
    deep = next((recording / "mav0" / "cam0" / "data").iterdir())
    for place in (deep, recording / "mav0" / "cam0" / "sensor.yaml"):
        before = place.read_bytes()
        with pytest.raises(OutputError, match="is an input and would be replaced"):
            run(recording, tmp_path / "out", config=FAST, rrd=place)
        assert place.read_bytes() == before
    assert inside.read_bytes() == b"data"


def test_results_in_the_folder_of_a_recording_are_replaced(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    recording = shutil.copytree(synthetic_stereo, tmp_path / "recording")
    out = recording / "out"
    exports = Exports(ply=out / "m.ply")
    with pytest.raises(OutputError, match="out is inside the recording"):
        run(recording, out, config=FAST, end=2, exports=exports)
    assert not out.exists()
    assert run(recording, tmp_path / "out", config=FAST, end=2).tracked
    (tmp_path / "out").rename(out)  # as those of the release before
    for _ in range(2):
        assert run(recording, out, config=FAST, end=2, exports=exports).tracked


def test_an_rrd_file_does_not_replace_an_input_log(tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    log.write_bytes(b"data")
    link = tmp_path / "link.mcap"
    link.symlink_to(log)
    for target in (log, link):
        with pytest.raises(OutputError, match="mcap is an input and would be replaced"):
            run(log, tmp_path / "out", config=FAST, rrd=target)
    assert log.read_bytes() == b"data"


@pytest.mark.parametrize("kind", ["mcap", "ply", "colmap", "rrd", "record"])
@pytest.mark.parametrize("is_dangling", [False, True])
def test_an_output_that_is_a_link_to_a_file_is_refused(
    synthetic_stereo: Path, tmp_path: Path, kind: str, is_dangling: bool
) -> None:
    (tmp_path / "mine").write_text("data")
    link = tmp_path / "link"
    link.symlink_to(tmp_path / ("missing" if is_dangling else "mine"))
    is_export = kind in ("mcap", "ply", "colmap")
    options: Any = {"exports": Exports(**{kind: link})} if is_export else {kind: link}
    with pytest.raises(OutputError, match="link is a symbolic link, which is not followed"):
        run(synthetic_stereo, tmp_path / "out", config=FAST, end=2, **options)
    assert (tmp_path / "mine").read_text() == "data"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "mine"]


@pytest.mark.parametrize("name", ["summary.json", "trajectory.tum", "frames.csv.partial"])
def test_no_output_replaces_a_result_of_the_same_run(
    synthetic_stereo: Path, tmp_path: Path, name: str
) -> None:
    with pytest.raises(OutputError, match=f"{name} is already an output of this run"):
        run(synthetic_stereo, tmp_path, config=FAST, end=2, rrd=tmp_path / "x" / ".." / name)
    with pytest.raises(OutputError, match="is already an output of this run"):
        run(synthetic_stereo, tmp_path, config=FAST, exports=Exports(ply=tmp_path / name))
    assert not list(tmp_path.iterdir())


def test_two_outputs_cannot_be_one_file(synthetic_stereo: Path, tmp_path: Path) -> None:
    exports = Exports(mcap=tmp_path / "one", ply=tmp_path / "one")
    with pytest.raises(OutputError, match="one is already an output of this run"):
        run(synthetic_stereo, tmp_path / "out", config=FAST, exports=exports)


def test_an_rrd_file_is_replaced_by_a_later_run(synthetic_stereo: Path, tmp_path: Path) -> None:
    for _ in range(2):
        assert run(synthetic_stereo, tmp_path, config=FAST, end=2, rrd=tmp_path / "run.rrd").tracked


def test_file_names_may_contain_bytes_that_are_not_utf8(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    name = os.fsdecode(b"w\xe4lk")
    try:
        recording = shutil.copytree(synthetic_stereo, tmp_path / name)
    except OSError:
        pytest.skip("this file system has UTF-8 names only")
    out, rrd = tmp_path / "out", tmp_path / "run.rrd"
    assert run(recording, out, config=FAST, end=2, rrd=rrd).tracked == 2
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert summary["source"] == str(recording)
