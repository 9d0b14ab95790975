"""The open racing league for learning drivers."""

__version__ = "0.1.0"
