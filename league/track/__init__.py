"""Tracks: files, geometry, generation, drawing."""
