"""ROS nodes of learning and planning. Only modules here and ``convert`` may import rclpy."""

LEARNER, OPTION_SERVER, PLANNER = 'learner', 'option_server', 'planner'  # node names
