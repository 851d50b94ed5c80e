"""ROS nodes of learning and planning. Only modules in this package may import rclpy."""

LEARNER, OPTION_SERVER, PLANNER = 'learner', 'option_server', 'planner'  # node names
