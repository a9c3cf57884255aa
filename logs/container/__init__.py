"""The container that a log is: an MCAP file, whole or damaged, honest or not."""
