"""How a body moves: splines, kinds of motion, and what an inertial sensor feels."""
