"""Comparing a robot's dynamics with independent implementations: random states, the peers, and the report."""
