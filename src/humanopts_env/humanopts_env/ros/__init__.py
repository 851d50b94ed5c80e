"""ROS nodes, and what they share. Only modules here and ``convert`` may import rclpy."""
