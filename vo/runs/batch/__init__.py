"""Runs of many recordings: each in a process of its own, resumed, compared, and tabulated."""
