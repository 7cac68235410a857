# SPDX-License-Identifier: Apache-2.0
"""Benchmarks: takes a building's or rig's name and a controller, gives criteria J1 to J17 and those of other laws."""
