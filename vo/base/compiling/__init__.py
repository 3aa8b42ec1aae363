"""Functions that numba compiles once and that are then loaded as machine code without numba."""
