"""The docs site: every page has a place, and every link leads somewhere."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest
from docs_links import with_absolute_links

ROOT = Path(__file__).resolve().parents[1]
REPOSITORY = "https://example.org/repository"


@pytest.mark.skipif(
    importlib.util.find_spec("material") is None,
    reason="mkdocs-material is not installed; call scripts/setup dev",
)
def test_the_site_is_built_without_warnings(tmp_path: Path) -> None:
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "true"}
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    result = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300
    )
    assert result.returncode == 0, result.stderr
    page = (tmp_path / "index.html").read_text("utf-8")
    assert "blob/main/CHANGELOG.md" in page
    assert "fonts.googleapis.com" not in page  # nothing is loaded from other servers


def test_links_that_leave_the_docs_lead_to_the_repository() -> None:
    text = (
        "[a](../LICENSE) [b](outputs.md#x) [c](https://example.org) ![d](images/synth.jpg)\n"
        "[e](../vo/recordings/sources) [f](../configs/default.yaml#L3) [g](#here)"
    )
    expected = (
        f"[a]({REPOSITORY}/blob/main/LICENSE) [b](outputs.md#x) [c](https://example.org) "
        "![d](images/synth.jpg)\n"
        f"[e]({REPOSITORY}/tree/main/vo/recordings/sources) "
        f"[f]({REPOSITORY}/blob/main/configs/default.yaml#L3) [g](#here)"
    )
    assert with_absolute_links(text, "commands.md", ROOT / "docs", REPOSITORY) == expected
    deeper = with_absolute_links("[a](../../LICENSE)", "experiments/a.md", ROOT / "docs", "R")
    assert deeper == "[a](R/blob/main/LICENSE)"
