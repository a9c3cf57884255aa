"""What an evaluation reads: records of logs, the protocol, synchronized poses."""
