"""Who drives: scripted drivers and trained policies."""
