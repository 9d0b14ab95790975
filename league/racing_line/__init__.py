"""The fastest line round a track, and how fast a car may go on a given line."""
