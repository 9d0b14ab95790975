"""A replay, a race or a run in the Rerun viewer; no other package imports rerun."""

from league.rerun_view.live import Live
from league.rerun_view.record import save
from league.rerun_view.viewer import open_viewer, serve

__all__ = ["Live", "open_viewer", "save", "serve"]
