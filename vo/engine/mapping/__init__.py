"""The local map: keyframes, landmarks and observations, and how they are added and removed."""
