"""What is estimated from points in several images, on plain arrays."""
