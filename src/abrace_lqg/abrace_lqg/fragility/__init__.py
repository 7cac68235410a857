"""Fragility: takes models, controllers, sensor faults and ground motions, gives how likely limits are exceeded."""
