"""Hostile input for everything that reads files: mutated robots, tables and logs, and named attacks."""
