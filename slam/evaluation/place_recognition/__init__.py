"""Metrics of retrieval and loop closures."""
