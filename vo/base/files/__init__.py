"""Files of bounded size, and files that appear when they are complete."""
