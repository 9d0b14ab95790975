"""Races and evaluations: drivers on a track, the classification, tables and traces."""
