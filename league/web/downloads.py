"""What is no page: recordings for the Rerun viewer, the viewer's files, pictures, checkpoints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from starlette.requests import Request
from starlette.responses import Response

from league.video import strip
from league.web import rerun
from league.web.pages import heat
from league.web.reader import NotFoundError, Reader


@dataclass(frozen=True)
class Download:
    """An address, and how the answer to a request for it is made."""

    path: str
    """As Starlette writes routes."""
    answer: Callable[..., Response]
    """Returns the answer, from a Reader, the request and the parameters of the path."""

    def respond(self, reader: Reader, request: Request) -> Response:
        """Answer a request."""
        return self.answer(reader, request, **request.path_params)


def camera(reader: Reader, _: Request, number: int, race: int, car: int) -> Response:
    """Return what one car saw in a race, as a film strip."""
    digest = heat.recording(reader, number, race)
    replay = reader.replay(digest)
    if not 1 <= car <= replay.num_cars:
        raise NotFoundError(f"This race has the cars 1 to {replay.num_cars}.")
    content = reader.large(("strip", digest, car), lambda: strip.picture(replay, car - 1))
    return Response(content, media_type="image/jpeg", headers=rerun.FOR_GOOD)


def checkpoint(reader: Reader, _: Request, number: int) -> Response:
    """Return a policy's weights and card, if its owner lets everyone have them."""
    entry = reader.entry(number)
    if not entry.downloadable:
        raise NotFoundError(f"The owner of driver {number} has not offered it for download.")
    headers = {"Content-Disposition": f'attachment; filename="driver_{number}.safetensors"'}
    content = reader.store.blobs.get(entry.blob)
    return Response(content, media_type="application/octet-stream", headers=headers)


def recording(reader: Reader, _: Request, number: int, race: int) -> Response:
    """Return a race as a file of the Rerun viewer."""
    digest = heat.recording(reader, number, race)
    content = reader.large(("rerun", digest), lambda: rerun.recording(reader.store, digest))
    return Response(content, media_type="application/octet-stream", headers=rerun.FOR_GOOD)


DOWNLOADS = (
    Download("/drivers/{number:number}/checkpoint", checkpoint),
    Download("/heats/{number:number}/races/{race:number}/cars/{car:number}/camera.jpg", camera),
    Download("/heats/{number:number}/races/{race:number}/race.rrd", recording),
    Download("/heats/{number:number}/races/{race:number}/rerun", rerun.open_race),
    Download("/rerun/{release}/{name}", rerun.viewer_file),
)
"""All of them."""
