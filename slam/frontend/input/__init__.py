"""From messages to scans: records, labels, and where the sensors sit."""
