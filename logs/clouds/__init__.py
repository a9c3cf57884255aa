"""Labelled point clouds -> objects. Knows nothing of logs but their records."""
