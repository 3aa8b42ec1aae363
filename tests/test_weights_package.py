"""The wheel with files of learned features: `vo` finds them where it is installed."""

from __future__ import annotations

import importlib.metadata
import zipfile
from pathlib import Path

import pytest
import weights

from vo.base.errors import ModelError
from vo.engine.learned.catalog import find_model
from vo.engine.learned.files import model_file, path_of, verify, write


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An installation of a wheel with files of both models; no others are here."""
    monkeypatch.setenv("VO_MODELS", str(tmp_path / "made"))
    for name in weights.MODELS:
        write(find_model(name), name.encode(), find_model(name).weights_sha256)
    wheel = weights.make(tmp_path / "dist")
    monkeypatch.setenv("VO_MODELS", str(tmp_path / "none"))
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "site")
    return tmp_path / "site"


def test_files_of_the_package_are_used(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not path_of(find_model("xfeat")).is_file()
    monkeypatch.syspath_prepend(str(site))
    for name in weights.MODELS:
        assert verify(find_model(name)) == site / "visual_odometry_weights" / f"{name}.onnx"
    (tmp := site.parent / "own").mkdir()
    monkeypatch.setenv("VO_MODELS", str(tmp))
    (tmp / "xfeat.onnx").write_bytes(b"of the user")
    assert model_file("xfeat") == tmp / "xfeat.onnx"
    with pytest.raises(ModelError, match="disk"):
        verify(find_model("disk"))


def test_the_package_needs_nothing_and_has_the_licence(site: Path) -> None:
    [package] = importlib.metadata.distributions(path=[str(site)])
    assert package.metadata["Name"] == "visual-odometry-weights"
    assert package.metadata["License-Expression"] == "Apache-2.0"
    assert package.requires is None
    texts = {each.name: each.read_text() for each in package.files or () if "licenses" in str(each)}
    assert "Apache License" in texts["LICENSE"]
    assert "xfeat" in texts["NOTICE"] and "Changed:" in texts["NOTICE"]
    assert all(each.hash is None or each.size for each in package.files or ())


def test_weights_of_other_licences_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="superpoint"):
        weights.make(tmp_path, ("superpoint",))
