# SPDX-License-Identifier: Apache-2.0
"""Checks of recorded tests and of the model identified from them: what can be trusted, what not, and why."""
