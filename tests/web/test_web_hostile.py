"""Hostile addresses, parameters and headers: never an internal error, never their own text back."""

from __future__ import annotations

import re

import pytest

from league.web.routes import PAGES

VALUES = (
    "-1", "0", "1.5", "9" * 15, "9" * 5000, "٣", "²", " 1", "+1", "1_0", "nan", " ", "\x00", "\n",
    "../../etc/passwd", "' OR 1=1 --", "<script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>', "{{7*7}}", "🚗" * 500, "\u202e", "a" * 20_000,
)  # fmt: skip
HEADERS = (
    {"accept-encoding": "gzip;q=nan, ,;"},
    {"range": "bytes=0-1,5-2"},
    {"if-modified-since": "yesterday"},
    {"cookie": "a=" + "b" * 4000},
    {"x-forwarded-host": "evil.example", "x-forwarded-proto": "gopher"},
    {"content-length": "5"},
    {"referer": "javascript:alert(1)", "origin": "null"},
)


def addresses() -> list[tuple[str, str]]:
    """Return each page with parameters, its numbers filled in, and each parameter's name."""
    filled = ((re.sub(r"\{\w+:number\}", "1", page.path), page) for page in PAGES)
    return [(path.replace("1/1", "1/3"), name) for path, page in filled for name in page.query]


@pytest.mark.parametrize(("path", "name"), addresses())
def test_no_parameter_makes_an_internal_error_or_comes_back_as_markup(client, path, name):
    for value in VALUES:
        answer = client.get(path, params={name: value})
        assert answer.status_code in (200, 404), (path, name, value[:40])
        assert "<script>alert" not in answer.text and "<img" not in answer.text


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.path)
def test_no_number_in_an_address_makes_an_internal_error(client, page):
    for value in ("0", "9" * 15, "9" * 16, "9" * 5000, "-1", "1e3", "%00", "..", "٣"):
        path = re.sub(r"\{\w+:number\}", value, page.path)
        if path != page.path:
            assert client.get(path).status_code in (200, 404), path[:60]


@pytest.mark.parametrize("headers", HEADERS)
def test_no_header_changes_what_a_page_says(client, headers):
    answer = client.get("/standings", headers=headers)
    assert answer.status_code == 200
    assert (
        "evil" not in answer.text and "evil" not in client.get("/feed.atom", headers=headers).text
    )
    assert "content-security-policy" in answer.headers
