"""The rig and the table sample by sample: inputs in, samples out, each when it is due. Without ROS."""
