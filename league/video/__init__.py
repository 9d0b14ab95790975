"""Videos of a race: `render` makes an MP4, `still` one picture."""

from league.video.film import render, still

__all__ = ["render", "still"]
