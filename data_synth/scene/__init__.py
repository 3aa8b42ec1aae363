"""What can be seen: solids, ground, light, and the renderer."""
