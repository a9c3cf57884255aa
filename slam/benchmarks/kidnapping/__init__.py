"""Kidnapped robots: what they could know of their place, and whether they notice that they were carried off."""
