"""Bags in forms that other tools read."""
