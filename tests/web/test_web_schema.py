"""Real answers are what the OpenAPI document says, and requests made from it find no surprise."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

import jsonschema_rs
import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)
from starlette.testclient import TestClient

from league.web.app import make_app
from league.web.routes import PAGES
from league.web.security import Access
from league.web.token_api import ADDRESSES
from tests.matchmaking.season_kit import submitted
from tests.web.serving import FREE
from tests.web.small_league import ORIGIN, lapped_heat, raced_league, seasoned_league

CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_schema_conformance,
]
EXAMPLES = settings(
    max_examples=12,
    deadline=None,
    derandomize=True,
    database=None,
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=list(HealthCheck),
)

FREE_FORM = {
    "HeatAnswer.spec", "LeagueEntry.card", "Season.settings", "Cup.settings", "Lent.rulesets",
    "SentRace.result",
}  # fmt: skip
"""Settings, cards and results, which are checked by what reads them."""


@pytest.fixture(scope="module")
def seasoned(tmp_path_factory) -> Iterator[TestClient]:
    url = f"sqlite:///{tmp_path_factory.mktemp('seasoned') / 'league.db'}"
    with seasoned_league(url) as store:
        submitted(store, "new", senses="blind")
        access = Access(hosts=("127.0.0.1",), limits=FREE)
        with TestClient(make_app(store, access=access), base_url=ORIGIN) as client:
            client.heat = lapped_heat(store)
            yield client


def addresses(client: TestClient) -> dict[str, list[str]]:
    """Return addresses of each operation that answers GET without a token."""
    heat = client.heat
    ghosts = client.get("/api/v1/ghosts?track=reinvent_2018").json()["pair"]
    one, other = (lap["id"] for lap in ghosts)
    waits = client.get("/api/v1/live").json()["queue"][0]["number"]
    return {
        "home": ["home"],
        "standings": ["standings", "standings?against=3", "standings?track=x", "standings?cars=2"],
        "drivers/{number}": ["drivers/1", "drivers/3", "drivers/5"],
        "matchups/{one}/{other}": ["matchups/1/2", "matchups/2/3", "matchups/3/5"],
        "heats": ["heats", "heats?driver=3"],
        "heats/{number}": [
            f"heats/{heat}",
            f"heats/{heat}?lap=1",
            f"heats/{heat}?race=2",
            f"heats/{waits}",
        ],
        "heats/{number}/races/{race}/replay": [f"heats/{heat}/races/1/replay"],
        "tracks": ["tracks"],
        "ghosts": ["ghosts", "ghosts?track=reinvent_2018", f"ghosts?heat={heat}"],
        "ghosts/replay": [f"ghosts/replay?one={one}&other={other}"],
        "time-attack": ["time-attack", "time-attack?races=time_trial"],
        "seasons": ["seasons"],
        "seasons/{number}": ["seasons/1", "seasons/2"],
        "cups/{number}": ["cups/1"],
        "definitions": ["definitions"],
        "live": ["live"],
    }


def test_real_answers_have_the_fields_that_are_described_and_no_others(seasoned):
    document = seasoned.get("/api/v1/openapi.json").json()
    asked = {f"/api/v1/{path}": some for path, some in addresses(seasoned).items()}
    assert set(asked) == {path for path, item in document["paths"].items() if "get" in item} - {
        one.path for one in ADDRESSES
    }
    for path, some in asked.items():
        content = document["paths"][path]["get"]["responses"]["200"]["content"]
        schema = {**content["application/json"]["schema"], "components": document["components"]}
        validator = jsonschema_rs.Draft202012Validator(schema)
        for address in some:
            answer = seasoned.get(f"/api/v1/{address}")
            assert answer.status_code == 200, address
            errors = [
                f"{one.instance_path}: {one.message[:300]}"
                for one in validator.iter_errors(answer.json())
            ]
            assert not errors, (address, errors[:5])
            extra = copy.deepcopy(answer.json())
            extra["surprise"] = 1
            assert not validator.is_valid(extra), address


def test_every_object_says_what_is_in_it(seasoned):
    document = seasoned.get("/api/v1/openapi.json").json()
    schemas = dict(document["components"]["schemas"])
    for path, item in document["paths"].items():
        for operation in item.values():
            for media in operation["responses"]["200"]["content"].values():
                if media["schema"].get("title"):
                    schemas[media["schema"]["title"]] = media["schema"]
                else:
                    assert media["schema"].keys() - {"type"}, path
    vague = {where for name, schema in schemas.items() for where in _vague(schema, name)}
    assert vague <= FREE_FORM, vague - FREE_FORM


def _vague(schema: Any, where: str) -> Iterator[str]:
    """Yield where an object's fields are not described."""
    if isinstance(schema, list):
        for one in schema:
            yield from _vague(one, where)
    elif isinstance(schema, dict):
        own = schema.get("additionalProperties")
        if schema.get("type") == "object" and "properties" not in schema and own in (None, True):
            yield where
        for name, one in schema.items():
            if name == "properties":
                for field, value in one.items():
                    yield from _vague(value, f"{where}.{field}")
            elif name != "examples":
                yield from _vague(one, where)


def ask(operation, headers: dict[str, str], asked: dict[str, int]) -> None:
    """Send an operation requests that its description allows; check each answer."""

    @EXAMPLES
    @given(case=operation.as_strategy())
    def check(case):
        asked[operation.label] += 1
        case.call_and_validate(headers=headers, checks=CHECKS)

    check()


def test_requests_made_from_the_openapi_document_find_no_internal_error(tmp_path):
    with raced_league(f"sqlite:///{tmp_path / 'league.db'}", heats=6) as store:
        app = make_app(store, access=Access(hosts=("testserver",), limits=FREE))
        secret, _ = store.tokens.create("ann", ("admin",))
        schema = schemathesis.openapi.from_asgi("/api/v1/openapi.json", app)
        operations = [found.ok() for found in schema.get_all_operations()]
        assert len(operations) == len(ADDRESSES) + sum(page.has_api for page in PAGES)
        asked = dict.fromkeys((operation.label for operation in operations), 0)
        for operation in operations:
            for headers in ({"Authorization": f"Bearer {secret}"}, {}):
                ask(operation, headers, asked)
        assert min(asked.values()) > 1, asked
        assert store.verify().mismatches == []
