"""Benchmarks for researchers: they import the core, nothing imports them, and they are loaded on demand."""
