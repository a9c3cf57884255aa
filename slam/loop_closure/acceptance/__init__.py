"""Which candidates become loop closures."""
