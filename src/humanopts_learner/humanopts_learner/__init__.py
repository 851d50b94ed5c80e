"""Options learned from demonstrations, SMDP planning over them, and the nodes that serve both."""
