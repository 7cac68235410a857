"""A skyhook damper as a control law of one's own."""
