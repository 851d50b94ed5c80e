"""A simulated gripper that travels on a rail over a table with one object and a bin."""
