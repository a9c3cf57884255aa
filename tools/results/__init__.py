"""Commands that take results elsewhere."""
