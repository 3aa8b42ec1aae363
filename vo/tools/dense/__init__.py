"""Dense output of a finished run: depth of its keyframes, clouds, meshes and grids."""
