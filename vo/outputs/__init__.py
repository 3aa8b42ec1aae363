"""What a run leaves: results, recordings for viewers, live poses, errors, reports."""
