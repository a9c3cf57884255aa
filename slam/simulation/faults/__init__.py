"""Faults of the input of a kind that no message tells: of odometry, of detections, of clocks and of frames."""
