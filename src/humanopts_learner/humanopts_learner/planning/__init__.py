"""Planning over options: models, value iteration, and execution of plans."""
