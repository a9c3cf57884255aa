"""A check without ground truth whether the final trajectory is the best of a drive."""
