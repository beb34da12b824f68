"""Fits of simulated motion."""
