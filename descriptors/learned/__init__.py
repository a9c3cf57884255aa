"""Descriptors by networks."""
