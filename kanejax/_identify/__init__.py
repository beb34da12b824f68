"""Identification in one call: the stages one after another, what is known in the end, and the report."""
