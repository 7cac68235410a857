"""The laboratory: building, braces, records, sensors, and the nodes that run them."""
