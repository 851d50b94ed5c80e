"""A simulated rover: a differential drive with a laser scanner in a house of two rooms."""
