"""The ROS nodes for teaching and recording."""
