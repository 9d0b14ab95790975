"""The web application: routes, security headers and errors; the pages are listed in routes.py."""

from __future__ import annotations

import contextlib
import gzip
import hashlib
import re
from collections.abc import Awaitable, Callable, Sequence
from datetime import UTC, datetime
from http import HTTPStatus
from importlib import resources
from typing import Any

from markupsafe import Markup, escape
from starlette.applications import Starlette
from starlette.datastructures import MutableHeaders
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, RedirectResponse, Response
from starlette.routing import Match, Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from league import times
from league.errors import LeagueError
from league.matchmaking import safety
from league.matchmaking.documents import plain
from league.matchmaking.store import Store
from league.web import charts, openapi, rendering, token_api
from league.web.answers import Answers, Endpoint
from league.web.downloads import DOWNLOADS
from league.web.reader import Document, NotFoundError, Reader
from league.web.routes import PAGES, Page, likely
from league.web.security import Access

HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
        "connect-src 'self'; form-action 'self'; frame-ancestors 'none'; base-uri 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
STATIC = {
    "style.css": "text/css",
    "player.js": "text/javascript",
    "heat.js": "text/javascript",
    "live.js": "text/javascript",
    "htmx.min.js": "text/javascript",
    "icon.svg": "image/svg+xml",
}
"""All static files, with their types; they are read once, when the program starts."""


def make_app(store: Store, *, access: Access | None = None, exported: bool = False) -> App:
    """Return the application that shows a league, and takes submissions and results by token.

    If `exported`, its answers become files, which have no forms and no JSON.
    """
    reader, access = Reader(store), access or Access()
    answers = Answers(reader)
    templates = rendering.environment()
    filters: dict[str, Any] = templates.filters
    filters |= {"clock": times.clock, "counted": times.counted, "day": times.day}
    filters |= {"time_of_day": times.time_of_day, "iso": _iso, "code": _code}
    names: dict[str, Any] = {
        "league_name": store.settings.name,
        "static": lambda name: Markup(_static_bytes(name).decode()),
        "exported": exported,
        "has_api": False,  # unless a page says so
        "enough_corners": safety.ENOUGH_CORNERS,
        "bar": charts.bar,
    }
    templates.globals.update(names)

    def render(name: str, request: Request, status: int = 200, /, **document: object) -> Response:
        path, query = request.url.path, request.url.query
        template, origin = templates.get_template(name), str(request.base_url)
        return HTMLResponse(
            template.render(path=path, query=query, origin=origin, **document), status
        )

    def endpoint(one: Page, shown: Callable[[Request, Document], Response]) -> Callable[..., Any]:
        def respond(request: Request) -> Response:
            with access.reading(request):
                with store.at_once():
                    document = one.read(reader, request)
                response = shown(request, document)
            # How far a heat has come is not kept until it is over.
            if document.get("progress") or document.get("over") is False:
                response.headers["Cache-Control"] = "no-cache"
            return response

        return answers.shared(respond, lasting=not one.fleeting) if one.shared else respond

    def page(one: Page) -> Callable[..., Any]:
        def shown(request: Request, document: Document) -> Response:
            response = render(one.template, request, has_api=one.has_api, **document)
            response.headers["Content-Type"] = f"{one.media_type}; charset=utf-8"
            if one.file:
                name = one.file.format(**request.path_params)
                response.headers["Content-Disposition"] = f'attachment; filename="{name}"'
            return response

        return endpoint(one, shown)

    def data(_: Request, document: Document) -> Response:
        return JSONResponse(plain(_without_drawings(document)))

    def download(answer: Callable[..., Response]) -> Callable[[Request], Response]:
        return lambda request: answer(reader, access, request, **request.path_params)

    def failed(request: Request, error: Exception) -> Response:
        status, sentence = _status(error)
        headers = error.headers if isinstance(error, HTTPException) else None
        if request.url.path.startswith("/api/"):
            return JSONResponse({"error": sentence}, status, headers)
        content = templates.get_template("error.html").render(
            path="", query="", title=HTTPStatus(status).phrase, sentence=sentence
        )
        return HTMLResponse(content, status, headers)

    routes = [
        *(Route(one.path, page(one)) for one in PAGES if one.template),
        *(Route(one.api_path, endpoint(one, data)) for one in PAGES if one.has_api),
        *(Route(path, download(answer)) for path, answer in DOWNLOADS.items()),
        Route(openapi.PATH, lambda _: JSONResponse(openapi.document(store.settings.name))),
        *(Route(f"/static/{name}", _static(name)) for name in STATIC),
        Route("/favicon.ico", lambda _: RedirectResponse("/static/icon.svg", 308)),
    ]
    if not exported:
        routes += [one.route(reader, access, render) for one in token_api.FORMS]
        routes += [one.route(store, access) for one in token_api.ADDRESSES]
    app = Starlette(
        routes=routes,
        middleware=[
            Middleware(TrustedHostMiddleware, allowed_hosts=list(access.hosts), www_redirect=False),
            Middleware(GZipMiddleware, minimum_size=1000, compresslevel=6),
        ],
        exception_handlers={HTTPException: failed, LeagueError: failed},
    )

    def warm() -> None:
        for name in templates.list_templates():
            templates.get_template(name)
        for one in PAGES:
            if one.shared and "{" not in one.path:
                with contextlib.suppress(LeagueError):
                    one.document(reader, **dict.fromkeys(one.query, ""))

    def prepare() -> bool:
        return answers.last is not None and answers.prepare(
            _asked(address, routes, answers.last) for address in likely(reader)
        )

    return App(app, warm, prepare)


def _asked(address: str, routes: Sequence[Route], like: Request) -> tuple[Endpoint, Request]:
    """Return the endpoint of an address, and a request for it as from a visitor who made one."""
    path, _, query = address.partition("?")
    names = {"path": path, "raw_path": path.encode(), "query_string": query.encode()}
    scope = {**like.scope, **names, "path_params": {}, "client": None}
    matches = ((route.endpoint, route.matches(scope)) for route in routes)
    endpoint, found = next((one, more) for one, (match, more) in matches if match is Match.FULL)
    return endpoint, Request({**scope, **found})


def _status(error: Exception) -> tuple[int, str]:
    """Return an error's HTTP status, and the sentence that describes it."""
    if isinstance(error, NotFoundError):
        return 404, str(error)
    if isinstance(error, HTTPException):
        # Starlette's own two words, as sentences; others are sentences already.
        known = {404: "There is no such page.", 405: "This address does not answer that method."}
        usual = error.detail == HTTPStatus(error.status_code).phrase
        return error.status_code, known.get(error.status_code, "") if usual else error.detail
    return 503, f"{error}."


def _iso(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds")


def _code(text: str) -> Markup:
    """Return a text in which commands stand between backticks as HTML."""
    return Markup(re.sub("`([^`]+)`", r"<code>\1</code>", str(escape(text))))


def _without_drawings(value: object) -> object:
    """Return a page's data without the shapes of its charts and maps."""
    if isinstance(value, dict):
        return {
            name: _without_drawings(item)
            for name, item in value.items()
            if not isinstance(item, charts.Chart | charts.TrackMap)
        }
    return [_without_drawings(item) for item in value] if isinstance(value, list) else value


def _static_bytes(name: str) -> bytes:
    return resources.files("league.web").joinpath("static", name).read_bytes()


def _static(name: str) -> Callable[[Request], Awaitable[Response]]:
    """Return the endpoint of a static file; browsers keep it, and ask whether it is still this."""
    content = _static_bytes(name)
    packed = gzip.compress(content, 9)  # once, instead of for each visitor
    # A new version of the program must not meet an old one's script in the browser's cache.
    tag = f'W/"{hashlib.sha256(content).hexdigest()[:32]}"'
    headers = {"Cache-Control": "no-cache", "ETag": tag, "Vary": "Accept-Encoding"}

    async def respond(request: Request) -> Response:
        if request.headers.get("if-none-match") == tag:
            return Response(status_code=304, headers=headers)
        if "gzip" not in request.headers.get("accept-encoding", ""):
            return Response(content, media_type=STATIC[name], headers=headers)
        sent = {**headers, "Content-Encoding": "gzip"}
        return Response(packed, media_type=STATIC[name], headers=sent)

    return respond


class App:
    """The application; adds `HEADERS` to every response, errors included, that has none of its own.

    `warm` makes what the first visitors would wait for: templates, boards, bounds of tracks.
    `prepare` makes one page that the next visitor is likely to ask for, unless a visitor waits for
    one; it returns whether there was one to make.
    """

    def __init__(self, app: ASGIApp, warm: Callable[[], None], prepare: Callable[[], bool]) -> None:
        self._app, self.warm, self.prepare = app, warm, prepare

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, as ASGI has it."""

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        await self._app(scope, receive, send_with_headers)
