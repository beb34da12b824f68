"""Fits of forces: linear least squares, nonlinear least squares by inverse dynamics, and what the data determine."""
