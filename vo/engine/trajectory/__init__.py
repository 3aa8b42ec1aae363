"""The trajectory: causal poses as first known, and smoothed poses attached to keyframes."""
