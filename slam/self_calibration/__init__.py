"""What a log tells of its sensors: noise, scales and faults of the input."""
