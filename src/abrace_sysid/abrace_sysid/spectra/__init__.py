"""Time histories to transfer functions and their noise."""
