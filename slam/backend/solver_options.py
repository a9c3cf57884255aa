"""How often the graph is updated, and how often it observes a landmark."""

GROUP_KEYFRAMES = 4
"""Consecutive keyframes that observe a landmark once, where the odometry between them is far better than a detection.
"""
UPDATE_KEYFRAMES = 5
"""Keyframes between two updates of iSAM2; in between only the local map follows."""
