"""Sliding-mode control as a control law of one's own."""
