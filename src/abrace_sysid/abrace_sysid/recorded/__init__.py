# SPDX-License-Identifier: Apache-2.0
"""Bags, files and arrays to recorded tests: their channels, inputs, periods."""
