"""Replays of one drive under many degradations and seeds."""
