"""Descriptors asked for the place at the revisits of drives."""
