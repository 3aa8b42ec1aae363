"""The output folder of a run: its files, statistics and summary."""
