"""ROS nodes of learning and planning. Only modules here and ``convert`` may import rclpy."""
