"""Makes the package visual-odometry-weights: files of free learned features, so that none fetches.

The wheel has the ONNX files of XFeat and LighterGlue, which are fetched if they are not here, the
licence of their weights, and a notice of who made them and what was changed (Apache-2.0, section
4). It needs no other package, and `vo` finds its files where it is installed.
"""

from __future__ import annotations

import argparse
import base64
import hashlib
import zipfile
from pathlib import Path

from vo.engine.learned.catalog import Model, find_model
from vo.engine.learned.files import WEIGHTS_PACKAGE, path_of, verify
from vo.tools.models.fetch import fetch

ROOT = Path(__file__).resolve().parents[1]
VERSION, LICENCE = "1.0", "Apache-2.0"
MODELS = ("xfeat", "lighterglue")
_METADATA = """Metadata-Version: 2.4
Name: {name}
Version: {version}
Summary: Files of learned features for visual-odometry: {models}.
License-Expression: Apache-2.0
License-File: LICENSE
License-File: NOTICE
Requires-Python: >=3.11
"""
_WHEEL = "Wheel-Version: 1.0\nGenerator: vo\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
_NOTICE = """Weights of learned features, under the licence Apache-2.0 (see LICENSE):

{models}

Changed: the tensors are unchanged; they are in ONNX files, with graphs of visual-odometry.
"""
_AUTHORS = {
    "xfeat": "G. Potje, F. Cadar, A. Araujo, R. Martins, E. R. Nascimento",
    "lighterglue": "the authors of XFeat, after LightGlue by P. Lindenberger, P.-E. Sarlin, M. "
    "Pollefeys",
}
_HOME = "https://github.com/verlab/accelerated_features"


def make(folder: Path, names: tuple[str, ...] = MODELS) -> Path:
    """Write the wheel to a folder.

    Raises:
        ModelError: a file is damaged, or cannot be fetched.
        ValueError: weights are under another licence.
    """
    models = [find_model(name) for name in names]
    others = [model.name for model in models if model.weights_licence != LICENCE]
    if others:
        raise ValueError(f"weights of {', '.join(others)} are not under {LICENCE}")
    stem = f"{WEIGHTS_PACKAGE}-{VERSION}"
    info = f"{stem}.dist-info"
    files: dict[str, bytes] = {f"{WEIGHTS_PACKAGE}/__init__.py": b'"""Files of vo models."""\n'}
    for model in models:
        if not path_of(model).is_file():
            fetch(model, None, accept_licence=False, say=print)
        path = verify(model)
        for each in (path, path.with_suffix(".json")):
            files[f"{WEIGHTS_PACKAGE}/{each.name}"] = each.read_bytes()
    listed = ", ".join(names)
    name = WEIGHTS_PACKAGE.replace("_", "-")
    files |= {
        f"{info}/METADATA": _METADATA.format(name=name, version=VERSION, models=listed).encode(),
        f"{info}/WHEEL": _WHEEL.encode(),
        f"{info}/licenses/LICENSE": (ROOT / "LICENSE").read_bytes(),
        f"{info}/licenses/NOTICE": _NOTICE.format(models="\n".join(map(_line, models))).encode(),
    }
    rows = [f"{at},sha256={_digest(content)},{len(content)}" for at, content in files.items()]
    files[f"{info}/RECORD"] = "\n".join([*rows, f"{info}/RECORD,,", ""]).encode()
    folder.mkdir(parents=True, exist_ok=True)
    wheel = folder / f"{stem}-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w", zipfile.ZIP_DEFLATED) as archive:
        for at, content in files.items():
            archive.writestr(zipfile.ZipInfo(at), content, zipfile.ZIP_DEFLATED)
    return wheel


def _line(model: Model) -> str:
    return f"{model.name}: {model.task} ({model.paper}), by {_AUTHORS[model.name]}; {_HOME}"


def _digest(content: bytes) -> str:
    return base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()


def main() -> None:
    """Write the wheel, and say what to do with it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=ROOT / "dist")
    wheel = make(parser.parse_args().output)
    print(f"{wheel}: {wheel.stat().st_size / 1e6:.1f} MB; pip install it, or publish it")


if __name__ == "__main__":
    main()
