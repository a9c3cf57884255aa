"""Where one constellation of objects lies in another."""
