"""YAML with the matrices of OpenCV, in the dialects of its versions."""

from __future__ import annotations

import re
from typing import Any

import yaml

from vo.base.files.bounded_yaml import SafeLoader, load_yaml

_HEADER = re.compile(r"\A\s*%YAML[: ]1\.\d[^\n]*\n")
_KEY_WITHOUT_SPACE = re.compile(r"^(\s*[A-Za-z_][\w.]*):(?=[^\s:])", re.MULTILINE)


class _Loader(SafeLoader):
    """Safe YAML loader that reads OpenCV's matrices as mappings."""


def _matrix(loader: _Loader, node: yaml.MappingNode) -> Any:
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _matrix)


def load_opencv_yaml(text: str) -> Any:
    """The first document of a text.

    Raises:
        ValueError: it is not YAML; see `load_yaml`.
    """
    if _HEADER.match(text):
        text = _HEADER.sub("", text)
        text = _KEY_WITHOUT_SPACE.sub(r"\1: ", text)  # OpenCV allows `key:value`
    return load_yaml(text.replace("\t", " "), _Loader, first_only=True)
