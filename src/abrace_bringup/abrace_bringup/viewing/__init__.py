# SPDX-License-Identifier: Apache-2.0
"""Samples of a rig to what a viewer in a browser shows: named channels, a moving building, forces; and their server."""
