"""Hostile headers of requests that would change something, without a token and with one."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from league.matchmaking.store import Store
from tests.web.small_league import RULES, new_league
from tests.web.submitting import ENTRIES, secret, served


@pytest.fixture
def store(tmp_path) -> Iterator[Store]:
    url = f"sqlite:///{tmp_path / 'league.db'}"
    with new_league(url, anchors=("centerline",), rules=RULES) as store:
        yield store


HOSTILE_HEADERS = (
    {"authorization": "Bearer"}, {"authorization": "Bearer " + "\t" * 50}, {"authorization": "é"},
    {"authorization": "Bearer league_\ud800"}, {"authorization": "Negotiate " + "A" * 60_000},
    {"content-type": ""}, {"content-type": "multipart/form-data; boundary=" + "-" * 70},
    {"content-type": "multipart/form-data; boundary=\"\\\""}, {"content-type": "a/b;" * 5000},
    {"content-type": "application/x-python-pickle"}, {"content-encoding": "gzip"},
    {"content-length": "0"}, {"content-length": "99999999999"}, {"transfer-encoding": "chunked"},
    {"expect": "100-continue"}, {"origin": "https://evil.example", "sec-fetch-site": "cross-site"},
    {"x-forwarded-for": "127.0.0.1, <script>"}, {"x-forwarded-proto": "gopher"},
    {"x-forwarded-host": "evil.example"}, {"forwarded": "for=127.0.0.1;host=evil.example"},
    {"x-http-method-override": "DELETE"}, {"x-original-url": "/admin"}, {"x-rewrite-url": "/"},
    {"cookie": "token=" + "x" * 8000}, {"referer": "javascript:alert(1)"}, {"te": "trailers"},
    {"upgrade": "websocket", "connection": "upgrade"}, {"accept": "text/html;q=nan"},
    {"accept-encoding": "gzip;q=9,br;q=-1"}, {"sec-fetch-site": "same-origin\x00"},
)  # fmt: skip


@pytest.mark.parametrize("headers", HOSTILE_HEADERS)
def test_hostile_headers_enter_nothing_and_make_no_internal_error(store, headers):
    hostile = [
        (name.encode(), value.encode("utf-8", "surrogatepass")) for name, value in headers.items()
    ]
    with served(store) as client:
        for path in (f"{ENTRIES}?name=a", f"{ENTRIES}/retire", "/submit", "/drivers/1/retire"):
            answer = client.post(path, content=b"{}", headers=hostile)
            assert 400 <= answer.status_code < 500, (path, answer.text)
            assert "evil" not in answer.text and "content-security-policy" in answer.headers
    assert len(store.entries()) == 1


HINDERS = {"authorization", "content-length", "content-type", "sec-fetch-site", "transfer-encoding"}
"""Headers that keep a request from the code behind the checks of token, body and form."""


@pytest.mark.parametrize("headers", HOSTILE_HEADERS)
def test_hostile_headers_with_a_token_reach_the_league_and_change_nothing(store, headers):
    own = secret(store)
    hostile = {
        name.encode(): value.encode("utf-8", "surrogatepass") for name, value in headers.items()
    }
    bearer = {b"authorization": f"Bearer {own}".encode()}
    form = {
        b"content-type": b"multipart/form-data; boundary=xyz",
        b"sec-fetch-site": b"same-origin",
    }
    parts = {"token": own, "name": "a", "sure": "yes", "file": "no weights"}
    fields = "".join(
        f'--xyz\r\nContent-Disposition: form-data; name="{name}"\r\n\r\n{value}\r\n'
        for name, value in parts.items()
    )
    bodies = {
        f"{ENTRIES}?name=a": (bearer, "no weights", "the submission 'a'"),
        f"{ENTRIES}/retire": (bearer, '{"entry": "centerline"}', "only its owner"),
        "/submit": (form, f"{fields}--xyz--\r\n", "the submission &#39;a&#39;"),
        "/drivers/1/retire": (form, f"{fields}--xyz--\r\n", "only its owner"),
    }
    with served(store) as client:
        for path, (usual, body, sentence) in bodies.items():
            given = [*{**usual, **hostile}.items()]
            answer = client.post(path, content=body.encode(), headers=given)
            assert 400 <= answer.status_code < 500, (path, answer.text)
            assert sentence in answer.text or HINDERS & set(headers), (path, answer.text)
            assert "evil" not in answer.text and own not in answer.text
            assert "content-security-policy" in answer.headers
    assert len(store.entries()) == 1 and store.entries()[0].state != "retired"
