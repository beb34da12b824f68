"""Kane's equations: generalized forces, the mass matrix, and the equations of motion."""
