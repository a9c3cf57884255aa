"""Descriptors from the literature, to compare with."""
