"""Bags, written and read with no ROS installed."""
