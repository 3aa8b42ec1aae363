"""The steps of the odometry, each of which joins several rooms."""
