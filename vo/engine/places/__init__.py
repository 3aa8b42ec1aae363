"""Recognition of places: stored keyframes, and a database that finds similar ones by words."""
