"""False closures, and what they do to a trajectory."""
