"""Robots and simulators as worlds: what is sensed, what can be done, and what ends an episode."""
