# SPDX-License-Identifier: Apache-2.0
"""Campaigns: reading and checking the file, and running its steps to bags, models, controllers and comparisons."""
