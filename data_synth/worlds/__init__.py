"""The worlds: procedural, seeded, nothing to download."""
