"""What faults of the input do to a map, and what is reported of them."""
