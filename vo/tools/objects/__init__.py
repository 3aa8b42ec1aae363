"""Recognition of textured objects: a database of them, and their instances in images."""
