"""Responses to an excitation that nobody measured to modes with intervals; whether a building has changed."""
