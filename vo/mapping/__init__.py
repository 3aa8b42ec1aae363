"""The map's storage: keyframes, landmarks and who saw what."""
