"""YAML (OpenCV's dialects too), JSON and OpenCV's XML as one kind of nested mapping."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree

import yaml

# What the parsers raise on purpose, and what they let through from the values they construct.
_FAILURES = (
    yaml.YAMLError,
    ElementTree.ParseError,
    ArithmeticError,
    AttributeError,
    LookupError,
    RecursionError,
    TypeError,
    ValueError,
)
_OPENCV_HEADER = re.compile(r"\A\s*%YAML[: ]1\.\d[^\n]*\n")
_KEY_WITHOUT_SPACE = re.compile(r"^(\s*[A-Za-z_][\w.]*):(?=[^\s:])", re.MULTILINE)


class _Loader(yaml.SafeLoader):
    """Safe YAML in which OpenCV's matrices are mappings."""


def _matrix(loader: _Loader, node: yaml.MappingNode) -> Any:
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _matrix)


def sections_of(text: str) -> tuple[Mapping[str, Any], str]:
    """The top-level mapping of a text, or an empty one and why there is none.

    Of a YAML stream with several documents the first counts, as `ros2 topic echo` writes it.
    """
    start = text.lstrip()[:1]
    try:
        if start == "<":
            return _xml(text), ""
        data = json.loads(text) if start == "{" and _is_json(text) else _yaml(text)
    except _FAILURES as error:
        language = "XML" if start == "<" else "YAML"
        return {}, f"is not {language}: {' '.join(str(error).split())}"
    return (data, "") if isinstance(data, Mapping) else ({}, "")


def _is_json(text: str) -> bool:
    try:
        json.loads(text)
    except (ValueError, RecursionError):
        return False
    return True


def _yaml(text: str) -> Any:
    if _OPENCV_HEADER.match(text):
        text = _OPENCV_HEADER.sub("", text)
        text = _KEY_WITHOUT_SPACE.sub(r"\1: ", text)  # OpenCV reads `key:value`
    loader = _Loader(text.replace("\t", " "))
    try:
        return loader.get_data()
    finally:
        loader.dispose()


def _xml(text: str) -> dict[str, Any]:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError("it declares entities, which a calibration has no use for")
    return {node.tag: _xml_value(node) for node in ElementTree.fromstring(text)}


def _xml_value(node: ElementTree.Element) -> Any:
    if len(node) == 0:
        words = (node.text or "").split()
        return words[0] if len(words) == 1 else words
    if all(child.tag == "_" for child in node):
        return [_xml_value(child) for child in node]
    return {child.tag: _xml_value(child) for child in node}
