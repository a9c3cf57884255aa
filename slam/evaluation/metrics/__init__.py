"""Metrics of trajectories, landmarks, covariances and relocalization."""
