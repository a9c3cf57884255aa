"""Simulated fleets, and how right their maps are."""
