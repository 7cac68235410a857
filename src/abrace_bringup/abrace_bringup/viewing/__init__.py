# SPDX-License-Identifier: Apache-2.0
"""The server to which Foxglove and Lichtblick connect, and their layout of a rig."""
