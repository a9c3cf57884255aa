"""One file for each family of encodings: messages of a log -> records."""
