"""Verification and acceptance of loop closures."""
