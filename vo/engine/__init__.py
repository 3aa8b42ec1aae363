"""The odometry: a path and its uncertainty from frames."""
