"""Rules that decide what is believed, each broken on purpose: the unit tests must notice."""
