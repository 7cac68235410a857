# SPDX-License-Identifier: Apache-2.0
"""Benchmarks: takes the name of a building or rig and a controller, gives the criteria J1 to J17 beside other laws'."""
