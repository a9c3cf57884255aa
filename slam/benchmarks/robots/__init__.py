"""Whole drives of several robots: what mapping makes of each."""
