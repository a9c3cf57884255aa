"""Handcrafted descriptors from the literature, to compare with."""
