# SPDX-License-Identifier: Apache-2.0
"""Time histories to transfer functions and their noise."""
