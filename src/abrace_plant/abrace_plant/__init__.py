# SPDX-License-Identifier: Apache-2.0
"""The laboratory: building, braces, records, sensors, and the nodes that run them."""
