"""What can be sought: a plant, its unknowns, and coordinates in which every iterate is physically consistent."""
