"""Output folders that belong to others: another run, or files that are no run's."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from vo.config import load_config
from vo.errors import OutputError
from vo.recording.exports import Exports
from vo.results.claim import claimed
from vo.run import run

FAST = load_config("fast")


def test_two_runs_do_not_write_to_one_folder(tmp_path: Path) -> None:
    code = (
        "import sys\nfrom pathlib import Path\nfrom vo.errors import OutputError\n"
        "from vo.results.claim import claimed\n"
        "try:\n    with claimed(Path(sys.argv[1])): print('mine')\n"
        "except OutputError as error: print(error)\n"
    )

    def other() -> str:
        command = [sys.executable, "-c", code, str(tmp_path)]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout

    with claimed(tmp_path):
        assert "another run is writing there; give another --output" in other()
    assert other() == "mine\n"


@pytest.mark.parametrize("name", ["config.yaml", "poses.csv", "summary.json"])
def test_files_of_others_are_not_replaced(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("[mine]\n", encoding="utf-8")
    with pytest.raises(OutputError, match=f"{name} is not of an earlier run"), claimed(tmp_path):
        pass
    assert (tmp_path / name).read_text(encoding="utf-8") == "[mine]\n"


def test_a_run_replaces_an_earlier_one_also_one_that_was_killed(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    assert run(synthetic_stereo, tmp_path, config=FAST, end=2).tracked == 2
    assert run(synthetic_stereo, tmp_path, config=FAST, end=2).tracked == 2
    (tmp_path / "summary.json").unlink()
    (tmp_path / "frames.csv").rename(tmp_path / "frames.csv.partial")
    assert run(synthetic_stereo, tmp_path, config=FAST, end=2).tracked == 2


def test_an_output_that_cannot_be_made_costs_no_earlier_run(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    run(synthetic_stereo, tmp_path, config=FAST, end=2)
    before = (tmp_path / "trajectory.tum").read_bytes()
    with pytest.raises(OutputError, match="cannot write the recording"):
        run(synthetic_stereo, tmp_path, config=FAST, end=2, rrd=tmp_path)
    assert (tmp_path / "trajectory.tum").read_bytes() == before


def test_a_recording_is_never_written_over(synthetic_stereo: Path, tmp_path: Path) -> None:
    recording = shutil.copytree(synthetic_stereo, tmp_path / "recording")
    inside = recording / "log.mcap"
    inside.write_bytes(b"precious")
    with pytest.raises(OutputError, match="log.mcap belongs to what is read"):
        run(recording, tmp_path / "out", config=FAST, exports=Exports(mcap=inside))
    with pytest.raises(OutputError, match="belongs to what is read"):
        run(inside, tmp_path / "out", config=FAST, exports=Exports(mcap=inside))
    deep = next((recording / "mav0" / "cam0" / "data").iterdir())
    for place in (deep, recording / "mav0" / "cam0" / "sensor.yaml"):
        before = place.read_bytes()
        with pytest.raises(OutputError, match="belongs to what is read"):
            run(recording, tmp_path / "out", config=FAST, rrd=place)
        assert place.read_bytes() == before
    assert inside.read_bytes() == b"precious"


def test_results_in_the_folder_of_a_recording_are_replaced(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    recording = shutil.copytree(synthetic_stereo, tmp_path / "recording")
    out = recording / "out"
    for _ in range(2):
        assert run(recording, out, config=FAST, end=2, exports=Exports(ply=out / "m.ply")).tracked


def test_a_log_is_not_replaced_by_what_rerun_gets(tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    log.write_bytes(b"precious")
    link = tmp_path / "link.mcap"
    link.symlink_to(log)
    for target in (log, link):
        with pytest.raises(OutputError, match="mcap belongs to what is read"):
            run(log, tmp_path / "out", config=FAST, rrd=target)
    assert log.read_bytes() == b"precious"


@pytest.mark.parametrize("name", ["summary.json", "trajectory.tum", "frames.csv.partial"])
def test_no_output_takes_the_place_of_a_result(
    synthetic_stereo: Path, tmp_path: Path, name: str
) -> None:
    with pytest.raises(OutputError, match=f"{name} is written already by this run"):
        run(synthetic_stereo, tmp_path, config=FAST, end=2, rrd=tmp_path / "x" / ".." / name)
    with pytest.raises(OutputError, match="is written already by this run"):
        run(synthetic_stereo, tmp_path, config=FAST, exports=Exports(ply=tmp_path / name))
    assert not list(tmp_path.iterdir())


def test_two_outputs_cannot_be_one_file(synthetic_stereo: Path, tmp_path: Path) -> None:
    exports = Exports(mcap=tmp_path / "one", ply=tmp_path / "one")
    with pytest.raises(OutputError, match="one is written already by this run"):
        run(synthetic_stereo, tmp_path / "out", config=FAST, exports=exports)


def test_what_rerun_got_is_replaced_by_a_later_run(synthetic_stereo: Path, tmp_path: Path) -> None:
    for _ in range(2):
        assert run(synthetic_stereo, tmp_path, config=FAST, end=2, rrd=tmp_path / "run.rrd").tracked


def test_names_that_are_no_utf8_cost_nothing(synthetic_stereo: Path, tmp_path: Path) -> None:
    name = os.fsdecode(b"w\xe4lk")
    try:
        recording = shutil.copytree(synthetic_stereo, tmp_path / name)
    except OSError:
        pytest.skip("this file system has UTF-8 names only")
    out, rrd = tmp_path / "out", tmp_path / "run.rrd"
    assert run(recording, out, config=FAST, end=2, rrd=rrd).tracked == 2
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert summary["source"] == str(recording)
