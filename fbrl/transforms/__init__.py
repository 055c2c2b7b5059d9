"""TorchRL transforms for rewards and observations; usable without gfootball installed."""
