# SPDX-License-Identifier: Apache-2.0
"""The nodes: parameters, topics and callbacks. The only modules of this package that import rclpy."""
