"""The estimator: odometry and detections become a trajectory and an object map."""
