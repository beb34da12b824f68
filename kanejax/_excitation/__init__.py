"""Design of motions that tell much."""
