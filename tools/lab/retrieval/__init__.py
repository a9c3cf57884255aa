"""Descriptors that are asked for the place: at the revisits of drives, and in maps of objects."""
