"""A target and its rig, emulated: takes a device file, gives what the hardware would send, with faults on demand."""
