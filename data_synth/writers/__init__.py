"""Writers of recordings in common layouts."""
