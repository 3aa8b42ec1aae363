"""Finding, describing, matching and refining image features."""
