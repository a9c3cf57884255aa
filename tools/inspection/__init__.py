"""Commands that look into logs and maps."""
