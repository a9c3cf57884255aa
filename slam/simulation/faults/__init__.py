"""Degradations and faults of the input: of odometry, detections, clocks and frames, without a message about them."""
