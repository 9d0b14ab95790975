"""The OpenAPI document of /api/v1, made from the list of pages."""

from __future__ import annotations

import re
from typing import Any

from pydantic import TypeAdapter

from league import __version__
from league.web.routes import PAGES, Page

PARAMETER = re.compile(r"\{(\w+):number\}")
PATH = "/api/v1/openapi.json"
"""Address of the document."""
_REF = "#/components/schemas/{model}"


def document(name: str) -> dict[str, Any]:
    """Return the OpenAPI document of a league's JSON interface.

    Args:
        name: of the league.
    """
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
    return {
        "openapi": "3.1.0",
        "info": {
            "title": f"League {name}",
            "version": __version__,
            "description": "What the pages show, as JSON. Lengths are metres, speeds m/s, times "
            "with names that end in _s seconds, ratings Elo. Only GET and HEAD are answered.",
        },
        "paths": paths,
        "components": {"schemas": schemas},
    }


def _operation(page: Page, schemas: dict[str, Any]) -> dict[str, Any]:
    properties = {}
    for name, kind in page.parts.items():
        schema = TypeAdapter(kind).json_schema(ref_template=_REF, mode="serialization")
        schemas.update(schema.pop("$defs", {}))
        properties[name] = schema
    numbers = [
        {
            "name": name,
            "in": "path",
            "required": True,
            "schema": {"type": "integer", "minimum": 0},
        }
        for name in PARAMETER.findall(page.path)
    ]
    texts = [
        {"name": name, "in": "query", "description": meaning, "schema": {"type": "string"}}
        for name, meaning in page.query.items()
    ]
    failure = {"application/json": {"schema": {"$ref": _REF.format(model="Error")}}}
    success = {"type": "object", "properties": properties}
    return {
        "summary": page.summary,
        "parameters": numbers + texts,
        "responses": {
            "200": {
                "description": page.summary,
                "content": {"application/json": {"schema": success}},
            },
            "404": {"description": "There is no such thing.", "content": failure},
            "503": {"description": "The league cannot be read now.", "content": failure},
        },
    }
