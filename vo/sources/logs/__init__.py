"""Logs of messages on topics, whatever the container.

A container offers a `Log` (`log.py`); `opening.open_log` makes a source of it: it finds the cameras
(`choice.py`), what they are (`rig.py`), their depth (`depth.py`) and the truth (`truth.py`).
"""
