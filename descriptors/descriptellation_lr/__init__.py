"""The learned likelihood ratio: one vector of an object of the map, one of an object seen, and their inner product."""
