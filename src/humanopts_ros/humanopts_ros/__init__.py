"""The common parts of all humanopts nodes, independent of games and options."""
