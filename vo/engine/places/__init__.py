"""Places: stored keyframes, recognition of places, and verification of loops."""
