"""Checks of what is given from outside, with errors that name the thing and the remedy."""
