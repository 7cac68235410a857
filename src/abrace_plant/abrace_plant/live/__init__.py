# SPDX-License-Identifier: Apache-2.0
"""The rig and the shake table in operation, sample by sample and without ROS: takes commands, gives readings."""
