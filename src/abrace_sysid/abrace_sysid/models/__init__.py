"""Poles and residues to state-space models, superposed, consistent or reduced."""
