"""Logs of messages on topics, independent of the container.

A container implements `Log` (`log.py`); `opening.open_log` creates a source from it: it chooses the
camera topics (`choice.py`) and reads calibration (`rig.py`), depth and ground truth (`poses.py`).
"""
