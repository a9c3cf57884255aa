"""Commands that are killed at any time: no file is lost or half there, and the same command gets to its end."""
