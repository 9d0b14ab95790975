"""A replay in the Rerun viewer; nothing outside this room imports rerun."""

from league.rerun_view.live import Live, open_viewer
from league.rerun_view.record import build, save
from league.rerun_view.stream import has_display

__all__ = ["Live", "build", "has_display", "open_viewer", "save"]
