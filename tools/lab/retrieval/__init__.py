"""Place recognition by descriptors and quads: at the revisits of drives, and in maps of objects."""
