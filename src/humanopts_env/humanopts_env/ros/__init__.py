"""ROS nodes and their shared code. Only modules in this package may import rclpy."""
