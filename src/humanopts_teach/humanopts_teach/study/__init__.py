"""Studies with human participants: plan, schedule of each participant, records and tables."""
