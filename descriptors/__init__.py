"""Descriptors: a constellation of labelled objects becomes a vector."""
