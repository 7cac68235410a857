"""Runs whole tests of the rig: nodes as processes, campaigns, reports, the `abrace` command."""
