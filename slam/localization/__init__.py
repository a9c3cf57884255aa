"""Localization of the robot in its own map or a prior map."""
