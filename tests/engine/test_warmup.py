"""Compilation happens in `vo warmup`, or once before the first frame, and never again."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from vo.base.scheduling import available_cores
from vo.engine import warmup

VO = Path(sys.executable).with_name("vo")
NOTICE = "compiling the inner loops, once"
# Creates an odometry, and prints whether the given file exists before the first frame.
LIBRARY_USE = """
import logging, sys
from pathlib import Path
from vo.base.compiling.processor import use_common_instructions
use_common_instructions()
from vo.base.config import load_config
from vo.engine.odometry import Odometry
from vo.base.types import Camera, Rig

logging.basicConfig(level=logging.INFO)
Odometry(Rig(Camera(320, 240, 200.0, 200.0, 160.0, 120.0)), load_config()).close()
print(Path(sys.argv[1]).exists())
"""

# The command `vo warmup`, and then the functions that its process has compiled.
WARMUP = """
import sys
from vo.cli.entry import main

sys.argv = ["vo", "warmup"]
try:
    main()
finally:
    from vo.base.compiling.function import compiled_here
    print(*compiled_here())
"""


def run(cache: Path, *command: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command,
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )


def files_in(cache: Path) -> set[str]:
    return {path.name for path in (cache / "vo").iterdir()}


@pytest.fixture(scope="module")
def first_warmup(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, str]:
    """Cache folder after `WARMUP`, and what that printed to standard output and error."""
    cache = tmp_path_factory.mktemp("cache")
    done = run(cache, sys.executable, "-c", WARMUP)
    return cache, done.stdout, done.stderr


@pytest.fixture
def outdated(first_warmup: tuple[Path, str, str], tmp_path: Path) -> tuple[Path, Path]:
    """A warm cache folder that lacks one function, and the file of that function."""
    cache = tmp_path / "cache"
    shutil.copytree(first_warmup[0], cache)
    for stamp in (cache / "vo").glob("warm-*"):
        stamp.unlink()
    (missing,) = (cache / "vo").glob("vo.engine.frontend.fast._corners-*")
    missing.unlink()
    return cache, missing


def test_warmup_compiles_once(first_warmup: tuple[Path, str, str]) -> None:
    cache, printed, notice = first_warmup
    assert printed.startswith("compiled in ")
    first, *others = notice.splitlines()
    assert first.startswith(NOTICE)
    assert all(line.startswith("warmup: working, ") for line in others)  # every ten seconds

    again = run(cache, VO, "warmup")

    assert again.stdout.startswith("nothing to compile;")
    assert again.stderr == ""


@pytest.mark.skipif(available_cores() < 2, reason="one core compiles in one process")
def test_first_compilation_uses_two_cores(first_warmup: tuple[Path, str, str]) -> None:
    """This process compiles those functions that are missing in the shared folder."""
    cache, printed, _ = first_warmup

    here = set(printed.splitlines()[-1].split())
    kept = {name.split("-")[0] for name in files_in(cache) if name.endswith(".bin")}
    assert here < kept
    assert "vo.engine.frontend.patch_kernels.align" in here  # of the first frames
    assert "vo.engine.geometry.pnp._gauss_newton" not in here


def test_stamp_depends_on_all_compiled_functions() -> None:
    package = Path(warmup.__file__).parents[1]
    rooms = {
        path.parent.relative_to(package).as_posix()
        for wing in ("base", "engine")
        for path in (package / wing).rglob("*.py")
        if "@compiled" in path.read_text(encoding="utf-8")
    }
    assert rooms <= set(warmup._ROOMS_WITH_KERNELS)


@pytest.mark.parametrize("mode", ["stereo", "mono"])
def test_run_after_warmup_compiles_nothing(
    first_warmup: tuple[Path, str, str], synthetic_stereo: Path, tmp_path: Path, mode: str
) -> None:
    cache = first_warmup[0]
    before = files_in(cache)

    done = run(cache, VO, "run", synthetic_stereo, "-o", tmp_path / "out", "--mode", mode)

    assert files_in(cache) == before
    assert NOTICE not in done.stderr


def test_messages_maps_and_pictures_after_warmup_compile_nothing(
    first_warmup: tuple[Path, str, str], synthetic_stereo: Path, tmp_path: Path
) -> None:
    """Raw images in messages and keyframes in maps are views that cannot be written to."""
    cache, log, out = first_warmup[0], tmp_path / "raw.mcap", tmp_path / "out"
    run(cache, VO, "convert", synthetic_stereo, log, "--codec", "raw", "--gray")
    before = files_in(cache)
    of_map = tmp_path / "map"

    for command in (
        ("run", log, "-o", out, "--save-map", of_map),
        ("run", log, "-o", out, "--map", of_map),
        ("render", out, "-o", tmp_path / "picture.png"),
    ):
        assert NOTICE not in run(cache, VO, *command).stderr

    assert files_in(cache) == before


def test_warmup_compiles_what_recordings_with_loops_need(
    first_warmup: tuple[Path, str, str],
) -> None:
    compiled = {name.split("-")[0] for name in files_in(first_warmup[0])}
    for name in (
        "loop_verification.relation._best_of",
        "places.covisibility._mark_shared",
        "places.inverted_index._score",
        "frontend.hamming_kernels.best_in_groups",
    ):
        assert f"vo.engine.{name}" in compiled


def test_first_run_compiles_only_what_its_cameras_and_sensors_need(
    first_warmup: tuple[Path, str, str], synthetic_stereo: Path, tmp_path: Path
) -> None:
    cache = tmp_path / "cache"
    shutil.copytree(first_warmup[0], cache)
    for part in ("vo.engine.inertial.", "vo.engine.geometry.triangulation.", "warm-"):
        for path in (cache / "vo").glob(f"{part}*"):
            path.unlink()
    before = files_in(cache)

    done = run(cache, VO, "run", synthetic_stereo, "-o", tmp_path / "out", "--no-imu")

    assert [name[:12] for name in files_in(cache) - before] == ["warm-stereo-"]
    assert NOTICE not in done.stderr


@pytest.mark.parametrize("quiet", [False, True])
def test_run_compiles_what_is_missing(
    outdated: tuple[Path, Path], synthetic_stereo: Path, tmp_path: Path, quiet: bool
) -> None:
    cache, missing = outdated
    options = ["--quiet"] if quiet else []

    done = run(cache, VO, "run", synthetic_stereo, "-o", tmp_path / "out", "--end", "2", *options)

    assert missing.exists()
    assert (NOTICE in done.stderr) is not quiet
    assert run(cache, VO, "warmup").stdout.startswith("nothing to compile;")


def test_library_compiles_before_the_first_frame(outdated: tuple[Path, Path]) -> None:
    cache, missing = outdated

    done = run(cache, sys.executable, "-c", LIBRARY_USE, missing)

    assert done.stdout == "True\n"
    assert NOTICE in done.stderr
