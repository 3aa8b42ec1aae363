"""Optional packages: imported where they are used, and named with their extra where one is missing.

The core of `visual-odometry` installs what tracking, MCAP files and the command line need. Other
packages belong to extras of pyproject.toml; modules that use them import them inside functions,
and call `require` before.
"""

from __future__ import annotations

import importlib
from types import ModuleType

from vo.errors import MissingExtraError

DISTRIBUTION = "visual-odometry"


def require(package: str, extra: str, what: str) -> ModuleType:
    """Import a package that an extra installs.

    Args:
        package: name of the package in `import`, such as `av`.
        extra: the extra of this distribution that installs it, such as `video`.
        what: what needs it, in the plural, such as `videos`.

    Raises:
        MissingExtraError: it is not installed, or cannot be imported.
    """
    try:
        return importlib.import_module(package)
    except ImportError as error:
        command = f"pip install '{DISTRIBUTION}[{extra}]'"
        is_missing = isinstance(error, ModuleNotFoundError) and error.name == package
        if is_missing:
            message = f"{what} need the extra '{extra}': {command}"
        else:
            message = f"{what} need {package}, which cannot be imported ({error}): {command}"
        raise MissingExtraError(message) from error
