# SPDX-License-Identifier: Apache-2.0
"""Recorded tests and the model identified from them to findings: what can be trusted, what not, and why."""
