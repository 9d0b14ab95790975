"""The JSON interface and its OpenAPI document, the feed, and the pages as files."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from urllib.parse import urlsplit

import pytest

from league.cli import main
from league.errors import ConfigError
from league.web import site
from league.web.routes import PAGES
from tests.web.small_league import NAME, lapped_heat

ATOM = "{http://www.w3.org/2005/Atom}"


def test_the_openapi_document_lists_every_page_and_parameter(client, store):
    document = client.get("/api/v1/openapi.json").json()
    assert document["openapi"].startswith("3.1")
    values = {"number": lapped_heat(store), "race": 1, "one": 2, "other": 3}
    queries = {"race": "1", "lap": "1", "against": "3", "before": "99", "kind": "policy"}
    fastest = store.results(lapped_heat(store))[0].result["order"][0]
    queries["one"] = queries["other"] = f"{lapped_heat(store)}.1.{fastest['car'] + 1}.1"
    pages = [page.api_path.replace(":number", "") for page in PAGES if page.has_api]
    for path in pages:
        operation = document["paths"][path]["get"]
        numbers = {one["name"] for one in operation["parameters"] if one["in"] == "path"}
        assert numbers == set(re.findall(r"\{(\w+)\}", path))
        asked = {name: str(3 if "/drivers" in path else values[name]) for name in numbers}
        texts = {one["name"] for one in operation["parameters"] if one["in"] == "query"}
        query = {name: queries[name] for name in texts if name in queries}
        answer = client.get(path.format(**asked), params=query)
        if path.startswith(("/api/v1/seasons/", "/api/v1/cups/")):  # this league has none
            assert answer.status_code == 404, path
            continue
        assert answer.status_code == 200, path
        properties = operation["responses"]["200"]["content"]["application/json"]["schema"]
        name = properties["$ref"].rsplit("/")[-1] if "$ref" in properties else None
        described = document["components"]["schemas"][name] if name else properties
        assert set(described["required"]) <= set(answer.json()) <= set(described["properties"])


def test_every_reference_of_the_openapi_document_leads_somewhere(client):
    answer = client.get("/api/v1/openapi.json")
    schemas = answer.json()["components"]["schemas"]
    names = re.findall(r'"#/components/schemas/(\w+)"', answer.text)
    assert {"Row", "HeadToHead", "Error"} <= set(names) <= set(schemas)


def test_an_error_of_the_interface_is_what_the_document_says(client):
    answer = client.get("/api/v1/drivers/99")
    assert answer.status_code == 404 and set(answer.json()) == {"error"}


def test_the_feed_has_the_newest_heats_with_addresses_of_their_own(client, store):
    answer = client.get("/feed.atom")
    assert answer.headers["content-type"].startswith("application/atom+xml")
    feed = ET.fromstring(answer.content)
    heats = client.get("/api/v1/heats").json()["heats"]
    entries = feed.findall(f"{ATOM}entry")
    assert [one.findtext(f"{ATOM}id") for one in entries] == [
        f"urn:sha256:{heat['key']}" for heat in heats
    ]
    link = entries[0].find(f"{ATOM}link").get("href")
    assert link == f"http://127.0.0.1/heats/{heats[0]['number']}"
    assert feed.findtext(f"{ATOM}updated") == entries[0].findtext(f"{ATOM}updated")
    assert any(NAME in one.findtext(f"{ATOM}title") for one in entries)
    assert client.get("/api/v1/feed.atom").status_code == 404


@pytest.fixture(scope="module")
def exported(store, tmp_path_factory):
    folder = tmp_path_factory.mktemp("site") / "season"
    assert main(["site", str(folder), "--heats", "3", "--league", store.url]) == 0
    return folder


def test_an_exported_league_has_a_page_for_each_driver_and_asked_heat(exported, store):
    assert {path.stem for path in (exported / "drivers").iterdir()} == {"1", "2", "3"}
    newest = [record.number for record in store.heats(("done",))[-3:]]
    heats = {path.name for path in (exported / "heats").iterdir()}
    assert heats == {f"{n}{race}.html" for n in newest for race in ("", "-race-2")}


def test_every_link_of_an_exported_page_is_a_file_of_it(exported):
    pages = list(exported.rglob("*.html"))
    assert len(pages) > 10
    for page in pages:
        text = page.read_text()
        for link in re.findall(r'(?:href|src)="([^"]*)"', text):
            url = urlsplit(link)
            assert not url.scheme and not url.netloc and not link.startswith("/")
            if url.path:
                assert (page.parent / url.path).is_file(), f"{page.name}: {link}"
        assert "/api/" not in text and "<form" not in text


def test_names_are_text_in_exported_pages_too(exported):
    for page in exported.rglob("*.html"):
        assert "<img" not in page.read_text()


def test_a_folder_with_something_in_it_is_not_written_to(store, tmp_path, capsys):
    (tmp_path / "mine.txt").write_text("kept")
    with pytest.raises(ConfigError, match="give a new folder"):
        site.export(store, tmp_path, heats=1)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    assert main(["site", str(tmp_path / "x"), "--heats", "-1", "--league", store.url]) == 2
    assert "--heats" in capsys.readouterr().err
