# SPDX-License-Identifier: Apache-2.0
"""Fragility: takes models, controllers, sensor faults and ground motions, gives how likely limits are exceeded."""
