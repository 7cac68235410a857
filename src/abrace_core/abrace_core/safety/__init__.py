# SPDX-License-Identifier: Apache-2.0
"""Limits and faults: the guard that every command passes, checks of the samples that it answers, the table's stop."""
