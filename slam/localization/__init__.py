"""Where the robot is, in its own map or a prior map."""
