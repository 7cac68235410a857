"""Nodes as processes: found, given parameters, started, watched, stopped, none left behind."""
