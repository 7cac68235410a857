# SPDX-License-Identifier: Apache-2.0
"""A target and its rig, emulated: takes a device file, gives what the hardware would send, with faults on demand."""
