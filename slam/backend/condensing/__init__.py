"""Keyframes that others represent, so that the graph grows with the map and not with the drive."""
