"""Robots and simulators as worlds: their features, actions and ends of episodes."""
