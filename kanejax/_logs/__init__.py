"""Recordings of robots: read, cleaned, and made into motions."""
