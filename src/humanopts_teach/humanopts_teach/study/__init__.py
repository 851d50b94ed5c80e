"""Studies with people: the plan, what each participant does in which order, and what is kept."""
