"""What a log holds, and how it is read and written. Knows nothing of SLAM."""
