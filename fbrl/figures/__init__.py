"""Figures for papers: learning curves and bar charts, drawn from the logs of runs."""
