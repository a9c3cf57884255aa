"""A made-up drive through a world of objects: odometry that drifts, detections that err, and the truth about both."""
