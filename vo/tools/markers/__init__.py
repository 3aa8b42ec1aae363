"""ArUco and AprilTag markers and boards: detection, pose, and what a marker tells of scale."""
