"""What each car sees."""
