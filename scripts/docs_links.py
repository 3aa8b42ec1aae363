"""A hook of mkdocs: links to files outside docs/ lead to the repository."""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath
from typing import Any

_LINK = re.compile(r"(\]\()(?!https?:|mailto:|#)([^()\s#]+)([^()\s]*\))")


def on_page_markdown(markdown: str, page: Any, config: Any, **_: Any) -> str:
    """Called by mkdocs with the text of each page."""
    return with_absolute_links(markdown, page.file.src_uri, Path(config.docs_dir), config.repo_url)


def with_absolute_links(markdown: str, page: str, docs: Path, repository: str) -> str:
    """Replace links that leave the folder of the docs by links to the repository.

    `repository`: address of the repository, without a slash at the end.
    """
    root = docs.resolve().parent

    def replace(match: re.Match[str]) -> str:
        target = (docs.resolve() / PurePosixPath(page).parent / match[2]).resolve()
        if target.is_relative_to(docs.resolve()) or not target.is_relative_to(root):
            return match[0]
        kind = "tree" if target.is_dir() else "blob"
        return f"{match[1]}{repository}/{kind}/main/{target.relative_to(root)}{match[3]}"

    return _LINK.sub(replace, markdown)
