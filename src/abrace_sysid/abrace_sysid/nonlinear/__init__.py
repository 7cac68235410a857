# SPDX-License-Identifier: Apache-2.0
"""Tests and the model identified from them to what is not linear in the rig, and the model simulated with it."""
