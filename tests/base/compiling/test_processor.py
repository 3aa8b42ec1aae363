"""The same bits on all processors that have the common instructions."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from vo.base.compiling.processor import has_common_instructions, use_common_instructions

VO = Path(sys.executable).with_name("vo")
LONGER = "avx avx2 bmi1 bmi2 f16c fma abm movbe avx512f avx512vl"
# Vectors that numpy, OpenCV and its IPP would choose by the processor.
SHORT_VECTORS = {
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL",
    "OPENCV_CPU_DISABLE": "AVX512-SKX,AVX2,FP16",
    "OPENCV_IPP": "disabled",
}


def _settled(tmp_path: Path, flags: str, given: dict[str, str]) -> dict[str, str]:
    info = tmp_path / "cpuinfo"
    info.write_text(f"processor\t: 0\nflags\t\t: fpu sse2 {flags} ht\n\nprocessor\t: 1\n")
    environment = dict(given)
    use_common_instructions(environment, info)
    return environment


def test_longer_vectors_are_left_out(tmp_path: Path) -> None:
    settled = _settled(tmp_path, LONGER, {"HOME": "/"})
    assert settled["NUMBA_CPU_NAME"] == "x86-64-v3"
    assert settled["OPENBLAS_CORETYPE"] == "Haswell"
    assert settled["HOME"] == "/"


@pytest.mark.parametrize("missing", ["avx2", "fma", "abm"])
def test_an_older_processor_does_what_it_can(tmp_path: Path, missing: str) -> None:
    assert _settled(tmp_path, LONGER.replace(f"{missing} ", ""), {}) == {}


def test_what_the_user_has_set_counts(tmp_path: Path) -> None:
    settled = _settled(tmp_path, LONGER, {"NUMBA_CPU_NAME": "generic"})
    assert settled == {"NUMBA_CPU_NAME": "generic", "OPENBLAS_CORETYPE": "Haswell"}


@pytest.mark.parametrize("core", ["Haswell", "SkylakeX"])
def test_what_is_set_for_blas_leaves_compiled_code_settled(tmp_path: Path, core: str) -> None:
    settled = _settled(tmp_path, LONGER, {"OPENBLAS_CORETYPE": core})
    assert settled["OPENBLAS_CORETYPE"] == core
    assert settled["NUMBA_CPU_NAME"] == "x86-64-v3" and settled["NUMBA_CPU_FEATURES"] == ""


@pytest.mark.parametrize(
    ("name", "features", "expected"),
    [("x86-64-v3", "", True), ("x86-64-v3", "-ssse3", False), ("generic", "", False)],
)
def test_code_for_other_instructions_is_known(
    monkeypatch: pytest.MonkeyPatch, name: str, features: str, expected: bool
) -> None:
    monkeypatch.setenv("NUMBA_CPU_NAME", name)
    monkeypatch.setenv("NUMBA_CPU_FEATURES", features)
    assert has_common_instructions() == expected


def test_another_kind_of_processor_is_left_alone(tmp_path: Path) -> None:
    environment: dict[str, str] = {}
    use_common_instructions(environment, tmp_path / "nothing")
    (tmp_path / "arm").write_text("processor\t: 0\nFeatures\t: fp asimd\n")
    use_common_instructions(environment, tmp_path / "arm")
    assert environment == {}


def test_the_path_does_not_depend_on_how_long_vectors_are(
    tmp_path: Path, synthetic_stereo: Path
) -> None:
    common: dict[str, str] = {}
    use_common_instructions(common)
    if not common:
        pytest.skip("this processor lacks the common instructions")
    unsettled = {name: value for name, value in os.environ.items() if name not in common}
    paths = []
    for name, change in (("by_itself", {}), ("told", common | SHORT_VECTORS)):
        command = [VO, "run", synthetic_stereo, "-o", tmp_path / name, "--quiet"]
        subprocess.run(command, env=unsettled | change, check=True, timeout=300)
        paths.append((tmp_path / name / "trajectory.tum").read_bytes())
    assert len(paths[0].splitlines()) == 30
    assert paths[0] == paths[1]
