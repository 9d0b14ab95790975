"""Placeholder."""

from __future__ import annotations


class Watching:
    """An onlooker that streams the first worlds' cars to the viewer."""

    def __init__(self, env) -> None:  # noqa: ANN001
        """Open the viewer."""

    def update(self, history, update) -> None:  # noqa: ANN001
        """Take note of an update."""

    def evaluated(self, history, evaluation) -> None:  # noqa: ANN001
        """Take note of an evaluation."""

    def close(self) -> None:
        """Close the viewer."""
