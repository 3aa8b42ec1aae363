"""Runs as one HTML page that can be sent to others."""
