"""Messages and pictures for viewers of a drive."""
