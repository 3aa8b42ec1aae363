"""Recordings: the formats of files and messages, and frames read from them.

Functions here raise `SourceError` for what is missing, damaged, inconsistent or not of the format,
and `CalibrationError` for values of a calibration that are missing or implausible. The message
names the file, the place in it, the value found, and what to do. Docstrings name other errors only.
"""
