# SPDX-License-Identifier: Apache-2.0
"""Limits and faults: the guard of every command, the state machine of faults and stops, checks of samples."""
