"""Every error that `vo` raises on purpose.

    VoError
    ├── ConfigError        a setting is unknown, of the wrong type or out of range
    ├── SourceError        a recording is missing, empty, damaged or not understood
    ├── CalibrationError   a camera's calibration is missing or cannot be true
    ├── EvaluationError    two trajectories cannot be compared
    └── OutputError        a result cannot be written

A message says in one line what failed, the value found, and what to do about it. The command line
prints it as
`error: …` and exits 1; any other exception is a bug and keeps its traceback.
"""


class VoError(Exception):
    """Root of the errors that a user can mend."""


class ConfigError(VoError):
    """A setting is unknown, of the wrong type or out of range."""


class SourceError(VoError):
    """A recording is missing, empty, damaged or not understood."""


class CalibrationError(VoError):
    """A camera's calibration is missing or cannot be true."""


class EvaluationError(VoError):
    """Two trajectories cannot be compared."""


class OutputError(VoError):
    """A result cannot be written."""
