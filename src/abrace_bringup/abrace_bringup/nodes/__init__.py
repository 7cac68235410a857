"""The nodes: parameters, topics and callbacks. Beside the launch description only these modules here import ROS."""
