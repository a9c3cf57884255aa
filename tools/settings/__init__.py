"""Commands about settings and calibrations."""
