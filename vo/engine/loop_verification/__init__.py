"""Verification of loops: whether two stored keyframes show the same place, and their relation."""
