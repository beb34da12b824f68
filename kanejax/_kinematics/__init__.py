"""Where the links are and how they move: orientations, positions, velocities, and Kane's partial velocities."""
