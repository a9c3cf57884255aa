"""Many logs to one map: each mapped by itself, found in one another, joined."""
