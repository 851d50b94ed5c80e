"""Planning over options: exact models, value iteration, and playing by the result."""
