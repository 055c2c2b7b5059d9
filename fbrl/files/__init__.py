"""Files that are written whole, or survive an interruption, whatever is in them."""
