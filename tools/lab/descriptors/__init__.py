"""Descriptors and registration, measured on single queries."""
