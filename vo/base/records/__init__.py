"""What wings tell each other about a run."""
