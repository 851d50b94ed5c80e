"""Terminal front end: key input, screen rendering, and the replay of bags."""
