"""Whether the final trajectory is the best of a drive, told without the truth."""
