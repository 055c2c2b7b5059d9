"""Matches to look at: recorded while they are played, drawn from above or by the engine."""
