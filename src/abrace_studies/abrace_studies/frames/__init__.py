# SPDX-License-Identifier: Apache-2.0
"""Plane frames: takes nodes, members and masses, gives matrices, models, and moments."""
