"""What researchers use beside the program: it imports the core, nothing imports it, and it is loaded on demand."""
