"""The odometry: its track, its noise, keyframes on it."""
