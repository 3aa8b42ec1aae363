"""Map files: written, read, checked, and loaded into the memory of a run."""
