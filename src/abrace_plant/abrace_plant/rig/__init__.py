"""A rig file to a model of the rig, its motion within its limits, and what its sensors read."""
