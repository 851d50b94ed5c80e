"""The teaching dialogue as a state machine: pure, without ROS."""
