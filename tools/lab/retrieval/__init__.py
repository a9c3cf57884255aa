"""Descriptors that are asked for the place, in drives and in maps of objects."""
