"""Domains as pure rules, the game node that serves one, and Gymnasium environments."""
