"""The folder of a run: its files, its counts and its summary."""
