"""The dialogue drawn in a terminal: keys in, lines out; and the replay of a bag."""
