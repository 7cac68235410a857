# SPDX-License-Identifier: Apache-2.0
"""Modes with intervals from responses to unmeasured excitation, and detection of changes of a building."""
