"""What is no page: recordings for the Rerun viewer, the viewer itself, pictures, checkpoints.

The installed SDK's web viewer is WebAssembly, which needs a looser policy than our pages have; it
applies to the viewer's page and to nothing else.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import re
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from functools import cache
from importlib import metadata
from pathlib import Path
from urllib.parse import quote

from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from league.errors import ReplayError
from league.matchmaking.store import Store
from league.video import stills
from league.web.pages import heats
from league.web.reader import NotFoundError, Reader
from league.web.security import Access

RRD_LIMIT_S = 300.0
"""Time after which the making of a recording is given up [s]."""
VIEWER_PAGE = "index.html"
FOR_GOOD = {"Cache-Control": "public, max-age=86400, immutable"}
"""Of what never changes: a race that was raced, a file of one version."""
_PACKING = threading.Lock()
"""The first visitors wait for one of them to pack the viewer, which takes seconds."""


def camera(
    reader: Reader, access: Access, request: Request, number: int, race: int, car: int
) -> Response:
    """Return what one car saw in a race, as a film strip."""
    digest = heats.recording(reader, number, race)
    replay = reader.replay(digest)
    if not 1 <= car <= replay.num_cars:
        raise NotFoundError(f"This race has the cars 1 to {replay.num_cars}.")
    content = access.large(
        reader, request, ("strip", digest, car), lambda: stills.strip(replay, car - 1)
    )
    return Response(content, media_type="image/jpeg", headers=FOR_GOOD)


def checkpoint(reader: Reader, _access: Access, _request: Request, number: int) -> Response:
    """Return a policy's weights and card, if its owner lets everyone have them."""
    entry = reader.entry(number)
    if not entry.downloadable:
        raise NotFoundError(f"The owner of driver {number} has not offered it for download.")
    headers = {"Content-Disposition": f'attachment; filename="driver_{number}.safetensors"'}
    content = reader.store.blobs.get(entry.blob)
    return Response(content, media_type="application/octet-stream", headers=headers)


def recording(reader: Reader, access: Access, request: Request, number: int, race: int) -> Response:
    """Return a race as a file of the Rerun viewer."""
    digest = heats.recording(reader, number, race)
    content = access.large(reader, request, ("rerun", digest), lambda: rrd_of(reader.store, digest))
    return Response(content, media_type="application/octet-stream", headers=FOR_GOOD)


def viewer_version() -> str:
    """Return the version of the installed viewer, which is part of its files' addresses."""
    return metadata.version("rerun-sdk")


def open_race(
    reader: Reader, _access: Access, request: Request, number: int, race: int
) -> Response:
    """Lead to the viewer with a race."""
    from league.rerun_view import viewer

    heats.recording(reader, number, race)
    origin = str(request.base_url).rstrip("/")
    url = quote(f"{origin}/heats/{number}/races/{race}/race.rrd", safe="")
    return RedirectResponse(
        f"/rerun/{viewer_version()}/{VIEWER_PAGE}?url={url}&{viewer.OPTIONS}", 303
    )


def viewer_file(
    _reader: Reader, _access: Access, _request: Request, release: str, name: str
) -> Response:
    """Return a file of the viewer, packed: it takes 14 MB instead of 43."""
    from league.rerun_view import viewer

    if release != viewer_version() or name not in viewer.FILES:
        raise NotFoundError("The viewer has no such file.")
    with _PACKING:
        files = _packed_viewer()
    if name not in files:
        raise NotFoundError("The viewer has no such file.")
    content, policy, size = files[name]
    headers = {
        "Content-Encoding": "gzip",
        **FOR_GOOD,
        # The page's progress display reads the unpacked size from here.
        "rerun-final-length": str(size),
        **({"Content-Security-Policy": policy} if policy else {}),
    }
    return Response(content, media_type=viewer.FILES[name], headers=headers)


def rrd_of(store: Store, digest: str) -> bytes:
    """Return a race, by its recording's hash, as a .rrd file, made by another process.

    Raises:
        ReplayError: it could not be made, or takes too long.
    """
    with tempfile.TemporaryDirectory(prefix="league-") as folder:
        source, made = Path(folder, "race.race"), Path(folder, "race.rrd")
        source.write_bytes(store.blobs.get(digest))
        command = [sys.executable, "-m", "league.cli", "view", str(source), "--rrd", str(made)]
        try:
            done = subprocess.run(command, capture_output=True, timeout=RRD_LIMIT_S, check=False)
        except subprocess.TimeoutExpired:
            raise ReplayError(f"the race takes more than {RRD_LIMIT_S:.0f} s to draw") from None
        if done.returncode or not made.is_file():
            raise ReplayError("the race cannot be drawn for the viewer: `league view` says why")
        return made.read_bytes()


@cache
def _packed_viewer() -> dict[str, tuple[bytes, str, int]]:
    """Return the viewer's files, each as gzip, with its policy and unpacked size."""
    from league.rerun_view import viewer

    return {
        name: (
            gzip.compress(content, 6),
            page_policy(content.decode()) if name == VIEWER_PAGE else "",
            len(content),
        )
        for name, content in viewer.assets().items()
    }


def page_policy(page: str) -> str:
    """Return the content security policy of the viewer's page.

    Its own inline scripts and style are named by their hashes, so that no other ones run.
    """
    scripts, styles = (
        " ".join(_hash(text) for text in re.findall(rf"<{tag}>(.*?)</{tag}>", page, re.DOTALL))
        for tag in ("script", "style")
    )
    return (
        f"default-src 'none'; script-src 'self' 'wasm-unsafe-eval' {scripts}; "
        f"style-src 'self' {styles}; img-src 'self' data: blob:; media-src 'self' data: blob:; "
        "connect-src 'self'; worker-src 'self' blob:; form-action 'none'; "
        "frame-ancestors 'none'; base-uri 'none'"
    )


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


DOWNLOADS: dict[str, Callable[..., Response]] = {
    "/drivers/{number:number}/checkpoint": checkpoint,
    "/heats/{number:number}/races/{race:number}/cars/{car:number}/camera.jpg": camera,
    "/heats/{number:number}/races/{race:number}/race.rrd": recording,
    "/heats/{number:number}/races/{race:number}/rerun": open_race,
    "/rerun/{release}/{name}": viewer_file,
}
"""All of them by their routes: what returns the answer to a request."""
