"""Benchmarks: `python -m experiments.benchmarks`."""
