# SPDX-License-Identifier: Apache-2.0
"""Figures of signals and models, and how figures are captioned and saved. Nothing that acts on a rig imports them."""
