"""Limits and faults: the guard that every command passes, and the checks of the samples that it answers."""
