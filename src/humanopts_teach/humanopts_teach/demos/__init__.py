"""Demonstrations as they are collected and kept: pure, without ROS."""
