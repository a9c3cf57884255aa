"""Foreign datasets turned into logs: one file a dataset, which validates it and names the file and line at fault."""
