"""Which entries meet: states of entries, heats, and the matchmaker."""
