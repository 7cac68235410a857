"""What a rig can be made of: the simulated one, and hardware behind a network."""
