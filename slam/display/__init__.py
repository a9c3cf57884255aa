"""What viewers show of a drive while it is mapped."""
