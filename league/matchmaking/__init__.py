"""Who races whom, and who is better."""
