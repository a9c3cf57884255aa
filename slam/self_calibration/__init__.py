"""Estimation of the sensors from a log: noise, scales and faults of the input."""
