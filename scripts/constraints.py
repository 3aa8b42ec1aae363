"""Writes constraints.txt: the versions of all dependencies with which the tests passed."""

from __future__ import annotations

from pathlib import Path

from dependencies import required

PATH = Path(__file__).resolve().parent.parent / "constraints.txt"
_HEAD = """\
# Versions of all dependencies, direct and indirect, with which the tests passed (Linux, x86-64):
#   pip install -c constraints.txt 'visual-odometry[all]'
# Written by scripts/constraints. Camera packages (extras realsense and oak) are not among them.
"""


def constraints() -> dict[str, str]:
    """Versions in constraints.txt, by distribution."""
    lines = PATH.read_text("utf-8").splitlines()
    return dict(line.split("==") for line in lines if line and not line.startswith("#"))


def main() -> None:
    """Write the file from the installed versions."""
    lines = [f"{name}=={version}\n" for name, version in required(("dev",)).items()]
    PATH.write_text(_HEAD + "".join(lines), "utf-8")


if __name__ == "__main__":
    main()
