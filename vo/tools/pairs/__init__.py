"""What two images have in common: matches, the geometry between them, motion."""
