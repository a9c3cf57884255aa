"""The command that looks into logs and maps."""
