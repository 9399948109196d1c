"""Where the junctions of a test are, and which of them are not what the rig file says."""
