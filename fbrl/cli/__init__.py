"""Command-line programs: one module per command, argument parsing and printing only."""

import os

# Commands draw files. A notebook names its own backend to the commands that it runs, which they
# lack, and without which matplotlib can't be imported.
os.environ["MPLBACKEND"] = "agg"
