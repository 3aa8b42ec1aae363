"""Visible scene: solids, ground, light, and the renderer."""
