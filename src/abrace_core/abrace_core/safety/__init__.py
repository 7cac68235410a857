"""What stands between a command and the rig: limits of commands, and the watch over the samples that they answer."""
