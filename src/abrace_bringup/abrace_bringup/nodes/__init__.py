# SPDX-License-Identifier: Apache-2.0
"""The nodes: parameters, topics and callbacks. Beside the launch description only these modules here import ROS."""
