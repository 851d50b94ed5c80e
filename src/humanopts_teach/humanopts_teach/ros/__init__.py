"""The ROS nodes of teaching and recording."""
