"""Command-line programs: one module per command, argument parsing and printing only."""
