"""Parser of YAML (including OpenCV's dialects), JSON and OpenCV's XML to nested mappings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from vo.base.files.bounded_json import load_json

if TYPE_CHECKING:  # both languages are loaded where a file is written in them
    from xml.etree import ElementTree

# Errors of the parsers, and of the constructors of values that they do not catch.
_FAILURES = (
    ArithmeticError,
    AttributeError,
    LookupError,
    RecursionError,
    SyntaxError,  # of XML
    TypeError,
    ValueError,
)
MAX_YAML_BYTES = 500_000
"""YAML takes about 7 s per megabyte; calibration files with all board corners have 0.1 MB."""


def sections_of(text: str) -> tuple[Mapping[str, Any], str]:
    """The top-level mapping of a text and "", or an empty mapping and the reason.

    Only the first document of a YAML stream is read: `ros2 topic echo` writes several.
    """
    start = text.lstrip()[:1]
    language = {"<": "XML", "{": "JSON"}.get(start, "YAML")
    try:
        if start == "<":
            return _xml(text), ""
        data = _json(text) if start == "{" else _yaml(text)
    except _FAILURES as error:
        return {}, f"is not {language}: {' '.join(str(error).split())}"
    return (data, "") if isinstance(data, Mapping) else ({}, "")


def _json(text: str) -> Any:
    """The value of a JSON text, or of YAML that begins like JSON."""
    try:
        return load_json(text)
    except ValueError as error:
        if len(text) > MAX_YAML_BYTES:
            raise
        try:
            return _yaml(text)
        except _FAILURES:
            raise error from None


def _yaml(text: str) -> Any:
    from vo.recordings.formats.calibration.opencv_yaml import load_opencv_yaml

    return load_opencv_yaml(text)


def _xml(text: str) -> dict[str, Any]:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError("declarations of entities are not allowed")
    from xml.etree import ElementTree

    return {node.tag: _xml_value(node) for node in ElementTree.fromstring(text)}


def _xml_value(node: ElementTree.Element) -> Any:
    if len(node) == 0:
        words = (node.text or "").split()
        return words[0] if len(words) == 1 else words
    if all(child.tag == "_" for child in node):
        return [_xml_value(child) for child in node]
    return {child.tag: _xml_value(child) for child in node}
