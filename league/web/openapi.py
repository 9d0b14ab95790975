"""The OpenAPI document of /api/v1, made from the list of pages."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Literal

from pydantic import TypeAdapter

from league import __version__
from league.web import token_api
from league.web.protected import Protected
from league.web.routes import PAGES, Page

PARAMETER = re.compile(r"\{(\w+):number\}")
PATH = "/api/v1/openapi.json"
"""Address of the document."""
REFUSALS = {
    "401": "The token is missing, not known, or has ended.",
    "403": "The token does not allow this.",
    "404": "There is no such thing.",
    "408": "The body took too long.",
    "409": "The program is of another version.",
    "413": "The body is too large.",
    "422": "The league refuses it; the sentence says why.",
    "429": "This is more than one client, or owner, may have; Retry-After says when to try again.",
    "503": "The league cannot be read or written now.",
}
"""Other answers of addresses that need a token."""
_REF = "#/components/schemas/{model}"


def document(name: str) -> dict[str, Any]:
    """Return the OpenAPI document of the JSON interface of a league of this name."""
    schemas: dict[str, Any] = {
        "Error": {
            "type": "object",
            "required": ["error"],
            "properties": {"error": {"type": "string", "description": "One sentence."}},
        }
    }
    paths = {
        PARAMETER.sub(r"{\1}", page.api_path): {"get": _operation(page, schemas)}
        for page in PAGES
        if page.has_api
    }
    paths |= {
        PARAMETER.sub(r"{\1}", one.path): {one.method.lower(): _protected(one, schemas)}
        for one in token_api.ADDRESSES
    }
    return {
        "openapi": "3.1.0",
        "info": {
            "title": f"League {name}",
            "version": __version__,
            "description": "What the pages show, as JSON. Lengths are metres, speeds m/s, times "
            "with names that end in _s seconds, ratings Elo. What needs a token says so; all else "
            "is open and answers GET and HEAD only.",
        },
        "paths": paths,
        "components": {
            "schemas": schemas,
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
        },
    }


def _schema(
    kind: Any,  # noqa: ANN401
    schemas: dict[str, Any],
    mode: Literal["serialization", "validation"] = "serialization",
) -> dict[str, Any]:
    """Return the schema of a type, and add those that it refers to."""
    schema = TypeAdapter(kind).json_schema(ref_template=_REF, mode=mode)
    found = schema.pop("$defs", {})
    if mode == "serialization":
        for one in (schema, *found.values()):
            if "properties" in one:  # an answer has no field that is not described
                one.setdefault("additionalProperties", False)
    schemas.update({name: _without_tuples(one) for name, one in found.items()})
    return _without_tuples(schema)


def _without_tuples(schema: Any) -> Any:  # noqa: ANN401
    """Return a schema in which tuples are arrays of any of their types: few tools know tuples."""
    if isinstance(schema, list):
        return [_without_tuples(one) for one in schema]
    if not isinstance(schema, dict):
        return schema
    schema = {name: _without_tuples(one) for name, one in schema.items()}
    kinds = schema.pop("prefixItems", [])
    different = [kind for at, kind in enumerate(kinds) if kind not in kinds[:at]]
    if different:
        schema["items"] = different[0] if len(different) == 1 else {"anyOf": different}
    return schema


def _content(schema: dict[str, Any], media_type: str = "application/json") -> dict[str, Any]:
    return {media_type: {"schema": schema}}


def _refusals(meanings: Mapping[str, str]) -> dict[str, Any]:
    failure = _content({"$ref": _REF.format(model="Error")})
    return {
        status: {"description": meaning, "content": failure} for status, meaning in meanings.items()
    }


def _protected(one: Protected, schemas: dict[str, Any]) -> dict[str, Any]:
    """Return the operation of an address that needs a token."""
    raw = _content({"type": "string", "format": "binary"}, "application/octet-stream")
    taken = raw if one.body is None else _content(_schema(one.body, schemas, "validation"))
    answer = raw if one.answer is bytes else _content(_schema(one.answer, schemas))
    operation: dict[str, Any] = {
        "summary": f"{one.summary} (scope {one.scope})",
        "security": [{"token": []}],
        "parameters": _parameters(one),
        "responses": {
            "200": {"description": one.summary, "content": answer},
            **_refusals(REFUSALS),
        },
    }
    if one.method == "POST":
        operation["requestBody"] = {"required": True, "content": taken}
    return operation


def _parameters(page: Page | Protected) -> list[dict[str, Any]]:
    numbers = [
        {"name": name, "in": "path", "required": True, "schema": {"type": "integer", "minimum": 0}}
        for name in PARAMETER.findall(page.path)
    ]
    texts = [
        {"name": name, "in": "query", "description": meaning, "schema": {"type": "string"}}
        for name, meaning in page.query.items()
    ]
    return numbers + texts


def _operation(page: Page, schemas: dict[str, Any]) -> dict[str, Any]:
    success = _schema(page.answer, schemas)
    refusals = {status: REFUSALS[status] for status in ("404", "429")}
    refusals["503"] = "The league cannot be read now."
    return {
        "summary": page.summary,
        "parameters": _parameters(page),
        "responses": {
            "200": {"description": page.summary, "content": _content(success)},
            **_refusals(refusals),
        },
    }
