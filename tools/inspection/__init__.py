"""Commands that print the contents of logs and maps."""

MAX_LISTED = 40
"""Entries of a list; of a longer one the others are counted."""
