"""Nodes as processes: finding, parameters, starting, watching and stopping them, so that none is left behind."""
