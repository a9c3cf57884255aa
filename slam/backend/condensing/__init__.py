"""Keyframes that others stand for, so that the graph grows with the map and not with the drive."""
