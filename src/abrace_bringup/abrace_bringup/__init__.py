"""Runs whole tests of the rig: processes, campaigns, reports, the `abrace` command."""
