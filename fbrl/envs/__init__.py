"""Football matches as Gymnasium environments."""
