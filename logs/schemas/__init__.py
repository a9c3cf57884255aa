"""Our own message definitions, and the modules that are generated from them."""
