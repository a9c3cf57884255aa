"""A simulated drive through a world of objects: odometry with drift, detections with errors, and the truth."""
