"""Benchmarks: how fast the engine, the environment, collection and training are, and by what.

``python -m benchmarks`` measures everything and writes the tables of ``docs/performance.md``;
``python -m benchmarks --help`` says how to measure less. Not part of the installed package.
"""
