# SPDX-License-Identifier: Apache-2.0
"""Sliding-mode control as a control law of one's own."""
