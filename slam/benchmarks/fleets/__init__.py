"""Fleets that never drove, and how right their maps are."""
