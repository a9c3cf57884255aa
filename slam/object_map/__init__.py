"""Landmarks, submaps of them, and maps on disk."""
