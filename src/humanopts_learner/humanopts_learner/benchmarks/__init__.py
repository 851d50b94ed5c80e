"""Benchmarks of planning and learning, each beside a yardstick measured in the same run."""
