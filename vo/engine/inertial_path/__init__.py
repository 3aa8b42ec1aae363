"""Metres, gravity and missing poses of a path by an inertial sensor."""
