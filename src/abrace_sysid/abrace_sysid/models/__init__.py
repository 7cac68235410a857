"""Poles and transfer functions to state-space models: superposed, consistent or reduced."""
