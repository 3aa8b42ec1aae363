"""Parsing of JSON that may be anything: every error is a ValueError."""

from __future__ import annotations

import json
import re
from typing import Any

_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")


def load_json(text: str | bytes) -> Any:
    r"""The value of a JSON text; halves of characters, as `\ud800`, are replaced.

    Raises:
        ValueError: it is not JSON, is nested too deeply, or a number is too long.
    """
    try:
        value = json.loads(text)
        if isinstance(text, str) and _SURROGATE.search(text):
            clean = json.dumps(value, ensure_ascii=False).encode(errors="replace")
            value = json.loads(clean)
        return value
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
