"""Addresses that need a token: what each takes, who may ask, and how it answers."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from pydantic import BaseModel, ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from league.errors import DatabaseError, LeagueError, QuotaError, brief
from league.matchmaking.documents import plain
from league.matchmaking.store import Scope, Store, Token
from league.web.security import Access, bearer, body_of, client_of, drain

UPLOADS = 4
"""Uploads that are read and checked at the same time; each may take 16 MiB."""
REQUESTS = 8
"""Other requests at the same time, for each address."""


@dataclass(frozen=True)
class Asked:
    """A request that passed: who asks, and what for."""

    store: Store
    access: Access
    token: Token
    body: Any
    """A checked `Protected.body`, or bytes."""
    query: Mapping[str, str]
    """Parameters of path and query."""


@dataclass(frozen=True)
class Protected:
    """An address that needs a token."""

    path: str
    """As Starlette writes routes."""
    summary: str
    """What it does, in a few words."""
    scope: Scope
    """What the token must allow."""
    handle: Callable[[Asked], object]
    """Does it; runs in a thread. Returns JSON's plain data, frozen data, or bytes."""
    answer: type
    """Type of what it returns."""
    method: Literal["GET", "POST"] = "POST"
    body: type[BaseModel] | None = None
    """What a POST holds; None for bytes."""
    most_bytes: int = 1 << 20
    """Longest body."""
    query: Mapping[str, str] = field(default_factory=dict)
    """Parameters after the question mark, all of them text, each with its meaning."""

    def route(self, store: Store, access: Access) -> Route:
        """Return the route that answers it."""
        is_upload = self.method == "POST" and self.body is None
        slots = asyncio.Semaphore(UPLOADS if is_upload else REQUESTS)

        async def respond(request: Request) -> Response:
            try:
                token = await run_in_threadpool(self._authorised, store, access, request)
            except HTTPException:
                await drain(request)
                raise
            async with slots:
                content = await body_of(request, self.most_bytes)
                query = {name: request.query_params.get(name, "") for name in self.query}
                asked = Asked(store, access, token, content, {**request.path_params, **query})
                return await run_in_threadpool(self._answer, asked)

        return Route(self.path, respond, methods=[self.method])

    def _authorised(self, store: Store, access: Access, request: Request) -> Token:
        token = access.token(store, bearer(request), self.scope, client_of(request))
        is_work = self.scope == "worker"
        limit = access.limits.work if is_work else access.limits.submissions
        limit.charge(str(token.number) if is_work else token.owner)
        return token

    def _answer(self, asked: Asked) -> Response:
        with refusing():
            value = self.handle(replace(asked, body=self._parsed(asked.body)))
        if isinstance(value, bytes):
            return Response(value, media_type="application/octet-stream")
        if isinstance(value, BaseModel):
            value = value.model_dump(mode="json")
        content = json.dumps(plain(value), ensure_ascii=False, separators=(",", ":"))
        return Response(content, media_type="application/json")

    def _parsed(self, content: bytes) -> object:
        """Return a body, checked."""
        if self.body is None:
            return content
        try:
            return self.body.model_validate_json(content)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
        where = ".".join(str(part)[:40] for part in first["loc"]) or "The body"
        found = "" if first["type"] in ("missing", "json_invalid") else brief(first["input"])
        reason = f"{first['msg'][:200]}{f', not {found}' if found else ''}"
        raise HTTPException(422, f"{where}: {reason}; see /api/v1/openapi.json.")


@contextmanager
def refusing() -> Generator[None]:
    """Turn what the league refuses into an answer with the reason.

    Raises:
        HTTPException: 429 for a quota, 503 for a database that fails, otherwise 422.
    """
    try:
        yield
    except QuotaError as error:
        raise HTTPException(429, f"{error}.") from error
    except DatabaseError as error:
        sentence = "The league cannot be read or written now: try again later."
        raise HTTPException(503, sentence) from error
    except LeagueError as error:
        raise HTTPException(422, f"{error}.") from error
