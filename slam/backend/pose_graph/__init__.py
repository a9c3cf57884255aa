"""Pose graphs: their optimisation, robust to wrong loop closures."""
