"""Optional packages: imported on demand, and named with their extra where one is missing."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from vo.base.errors import MissingExtraError
from vo.base.extras import require


def test_an_installed_package_is_returned() -> None:
    assert require("json", "video", "videos") is sys.modules["json"]


def test_a_missing_package_is_told_with_the_command_that_installs_it() -> None:
    with pytest.raises(MissingExtraError) as error:
        require("no_such_package", "video", "videos")
    assert str(error.value) == (
        "videos need the extra 'video': pip install 'visual-odometry[video]'"
    )


def test_a_package_that_cannot_be_imported_is_told_with_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "broken_package.py").write_text("import missing_part")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(MissingExtraError, match=r"No module named 'missing_part'.*\[ros\]"):
        require("broken_package", "ros", "ROS messages")
