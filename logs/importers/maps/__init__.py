"""Maps of objects from open data."""
