"""Learning values of options by playing: SMDP and intra-option Q-learning."""
