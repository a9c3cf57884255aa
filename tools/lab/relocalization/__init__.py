"""Kidnapped robots: how soon they are found in a map, and whether rightly."""
