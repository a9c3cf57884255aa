"""What this package depends on: licences, known weaknesses, and a list of it all."""
