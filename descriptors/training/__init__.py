"""Training of descriptor networks."""
