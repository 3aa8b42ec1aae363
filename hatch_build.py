"""Build hook: in the wheel `data_synth` is part of `vo`, where no other package has its name."""

from __future__ import annotations

import re
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

_MODULE = re.compile(r"\bdata_synth(?=\.\w)")


class MovesDataSynth(BuildHookInterface):  # type: ignore[type-arg]
    """Adds `vo/data_synth`, and what imports it, with the names that its modules have there."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Write the changed files to a temporary folder, and include them."""
        if version == "editable":
            return
        self._folder = TemporaryDirectory()
        root = Path(self.root)
        for number, path in enumerate(sorted(root.glob("vo/**/*.py"))):
            self._add(number, path, path.relative_to(root), build_data)
        for number, path in enumerate(sorted(root.glob("data_synth/**/*")), start=10_000):
            if path.suffix in (".py", ".typed"):
                self._add(number, path, Path("vo") / path.relative_to(root), build_data)

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the temporary folder."""
        if version != "editable":
            self._folder.cleanup()

    def _add(self, number: int, path: Path, target: Path, build_data: dict[str, Any]) -> None:
        text = path.read_text("utf-8")
        moved = _MODULE.sub("vo.data_synth", text)
        if moved == text and path.relative_to(self.root) == target:
            return
        copy = Path(self._folder.name) / f"{number}.py"
        copy.write_text(moved, "utf-8")
        build_data["force_include"][str(copy)] = target.as_posix()
