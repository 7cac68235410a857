"""The nodes: parameters, topics, callbacks and `main`, one module for each executable."""
