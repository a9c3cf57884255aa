"""Maps of several drives found in one another, and joined to one."""
