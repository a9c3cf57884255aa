"""Graphs and trajectories in other programs' formats."""
