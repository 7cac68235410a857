# SPDX-License-Identifier: Apache-2.0
"""A rig: takes a rig file, gives its linear model, its motion within the limits, and its sensors' readings."""
