"""Files that hold messages: MCAP, SQLite, and the folders and compressed files that they come in."""
