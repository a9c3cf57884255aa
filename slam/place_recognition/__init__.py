"""Retrieval of candidate places, and localization in a known map."""
