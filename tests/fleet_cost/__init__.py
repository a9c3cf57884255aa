"""What joining a fleet costs beside mapping its logs."""
