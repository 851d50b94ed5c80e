"""Pac-Man: maze, rules (one game and many at once), features, drawing and reference options."""
