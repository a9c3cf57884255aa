"""Registration of constellations of objects."""
