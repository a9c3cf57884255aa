"""Commands on saved maps."""
