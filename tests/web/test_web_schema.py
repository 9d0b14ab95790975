"""Schemathesis: requests made from the OpenAPI document find no internal error and no surprise."""

from __future__ import annotations

import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from league.web.app import make_app
from league.web.openapi import PROTECTED
from league.web.routes import PAGES
from league.web.security import Access
from tests.web.serving import FREE
from tests.web.small_league import raced_league

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
        assert len(operations) == len(PROTECTED) + sum(page.has_api for page in PAGES)
        asked = dict.fromkeys((operation.label for operation in operations), 0)
        for operation in operations:
            for headers in ({"Authorization": f"Bearer {secret}"}, {}):
                ask(operation, headers, asked)
        assert min(asked.values()) > 1, asked
        assert store.verify().mismatches == []
