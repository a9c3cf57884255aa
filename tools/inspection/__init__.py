"""Commands that look into logs and maps."""

MAX_LISTED = 40
"""Entries of a list; of a longer one the others are counted."""
