"""Motion of bodies: splines, kinds of motion, and inertial measurements."""
