"""The test programme and the simulator of the rig, which shares no solver with any fit."""
