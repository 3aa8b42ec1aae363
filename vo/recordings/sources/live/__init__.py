"""Live sources: cameras of this machine, network streams and stereo cameras with own drivers."""
