"""Errors raised by `vo`, all derived from `VoError`.

    VoError
    ├── ConfigError        a setting is unknown, of the wrong type or out of range
    ├── SourceError        a recording is missing, empty, damaged or of an unknown format
    ├── CalibrationError   a calibration is missing or invalid
    ├── ModelError         a file of learned weights is missing, damaged or of another kind
    ├── InputError         a value given to the library is of the wrong type, shape or order
    ├── EvaluationError    two trajectories cannot be compared
    ├── OutputError        a result cannot be written
    └── MissingExtraError  an optional package is needed and not installed

A message is one line: what failed, the value found, and what to do. The command line prints it as
`error: …` and exits with status 1; any other exception is a bug and keeps its traceback.
"""


class VoError(Exception):
    """Base class of errors that a user can fix."""


class ConfigError(VoError):
    """A setting is unknown, of the wrong type or out of range."""


class SourceError(VoError):
    """A recording is missing, empty, damaged or of an unknown format."""


class CalibrationError(VoError):
    """A calibration is missing or invalid."""


class NoCalibration(CalibrationError):
    """A recording of one camera has no calibration, which its images may show."""


class NoPairCalibration(CalibrationError):
    """A recording of a pair has no calibration; with a known baseline its images may show it."""


class ModelError(VoError):
    """A file of learned weights is missing, damaged or of another kind."""


class InputError(VoError):
    """A value given to the library is of the wrong type, shape, size or order."""


class EvaluationError(VoError):
    """Two trajectories cannot be compared."""


class OutputError(VoError):
    """A result cannot be written."""


class MissingExtraError(VoError):
    """An optional package is needed and not installed."""
