"""Optional packages: imported where they are used, and named with their extra where one is missing.

The core of `visual-odometry` installs what tracking, MCAP files and the command line need. Other
packages belong to extras of pyproject.toml; modules that use them import them inside functions,
and call `require` before.
"""

from __future__ import annotations

import importlib
import logging
from types import ModuleType

from vo.base.errors import MissingExtraError

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
    if package == "matplotlib":  # its lines about a home that is read-only are no news
        logging.getLogger(package).setLevel(logging.ERROR)
    try:
        return importlib.import_module(package)
    except ImportError as error:
        needed = f"the extra '{extra}'"
        if not isinstance(error, ModuleNotFoundError) or error.name != package:
            needed = f"{package}, which cannot be imported ({error})"
        raise MissingExtraError(
            f"{what} need {needed}: pip install '{DISTRIBUTION}[{extra}]'"
        ) from error
