"""What faults of the input do to a map, and what the user is told of them."""
