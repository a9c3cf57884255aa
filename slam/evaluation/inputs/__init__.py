"""Input of an evaluation: records of logs, the protocol, synchronized poses."""
