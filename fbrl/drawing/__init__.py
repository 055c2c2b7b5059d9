"""A state of a match, drawn from above."""
