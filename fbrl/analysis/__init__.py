"""What the logs and results of runs say: groups of seeds, convergence, intervals."""
