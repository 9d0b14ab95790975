"""Matchmaking: which entries race each other, and which are better."""
