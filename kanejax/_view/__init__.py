"""Robots in three dimensions: what is drawn where, as a page of the browser and as films."""
