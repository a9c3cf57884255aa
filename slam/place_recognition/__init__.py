"""Which places of the map a query may be."""
