"""The report of an optimal motion."""
