# SPDX-License-Identifier: Apache-2.0
"""The MCAP container: files to records and back, with every checksum, index and kind of damage. No ROS message here."""
