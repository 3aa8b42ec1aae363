"""Functions as machine code: compiled by numba once, loaded without numba from then on."""
