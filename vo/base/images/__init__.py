"""Image files and arrays as grey images."""
