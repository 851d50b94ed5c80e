"""The simulated teacher: a documented stand-in for a person, pure, without ROS."""
