"""Offline evaluation: the numbers of a lesson, from its demonstrations alone."""
