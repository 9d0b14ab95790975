"""Videos of a race."""
