# SPDX-License-Identifier: Apache-2.0
"""Limits and faults: the guard of every command, the states of faults and stops, the loop's messages."""
