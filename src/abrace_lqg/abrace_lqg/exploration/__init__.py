"""Many sets of weights and an ensemble of ground motions to responses, forces and margins of each."""
