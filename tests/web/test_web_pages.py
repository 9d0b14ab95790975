"""The league's pages and JSON, asked for as a browser does, without one."""

from __future__ import annotations

import asyncio
import gc
import gzip
import json
import re
import socket
import subprocess
import sys
import urllib.request
from html.parser import HTMLParser

import numpy as np
import pytest
from starlette.testclient import TestClient

from league.cli import main
from league.errors import ConfigError
from league.matchmaking import standings
from league.replay import format
from league.web import server
from league.web.app import make_app
from league.web.replay_data import player_data
from tests.web.small_league import (
    NAME,
    ORIGIN,
    OWNER,
    RULES,
    lapped_heat,
    new_league,
    rated_heat,
)

PAGES = (
    "/", "/standings", "/standings?against=3", "/drivers/1", "/drivers/3", "/matchups/1/3",
    "/heats", "/heats/1", "/tracks", "/ghosts", "/live", "/submit",
)  # fmt: skip


class Elements(HTMLParser):
    """Collects a page's elements, with their attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))


@pytest.mark.parametrize("path", PAGES)
def test_every_page_is_there_and_allows_no_foreign_script(client, path):
    answer = client.get(path)
    assert answer.status_code == 200
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy and "unsafe" not in policy
    assert answer.headers["x-content-type-options"] == "nosniff"
    sizes = [len(answer.content)]
    for tag, attributes in Elements(answer.text).found:
        assert tag != "style" and "style" not in attributes
        assert not any(name.startswith(("on", "hx-on")) for name in attributes)
        if tag in ("script", "img", "link"):
            address = attributes.get("src") or attributes.get("href") or ""
            own = "/heats/" if tag == "img" else "/static/"
            assert address.startswith(own) or address == "/feed.atom"
            sizes.append(len(client.get(address).content) if "/static/" in address else 0)
    assert sum(sizes) < 200_000


@pytest.mark.parametrize("path", PAGES)
def test_every_page_has_a_title_a_language_and_names_for_its_pictures(client, path):
    elements = Elements(client.get(path).text).found
    assert ("html", {"lang": "en"}) in elements
    assert sum(tag == "h1" for tag, _ in elements) == 1
    assert all(attributes.get("aria-label") for tag, attributes in elements if tag == "svg")


@pytest.mark.parametrize(
    "path",
    [
        "/",
        "/standings",
        "/standings?against=3",
        "/drivers/3",
        "/matchups/3/1",
        "/heats/1",
        "/heats",
    ],
)
def test_names_with_html_in_them_are_text(client, path):
    elements = Elements(client.get(path).text).found
    pictures = [attributes["src"] for tag, attributes in elements if tag == "img"]
    assert all(source.endswith("/camera.jpg") for source in pictures)
    assert all(attributes.get("src") for tag, attributes in elements if tag == "script")
    if path in ("/standings", "/drivers/3"):
        assert "&lt;img src=x" in client.get(path).text


def test_standings_on_the_page_and_in_json_are_those_of_the_command_line(client, store):
    rows = standings.of(store).rows
    listed = client.get("/api/v1/standings").json()["rows"]
    assert [(row["name"], row["elo"], row["wins"]) for row in listed] == [
        (row.name, row.elo, row.wins) for row in rows
    ]
    page = client.get("/standings").text
    places = [page.index(f'href="/drivers/{row.number}"') for row in rows]
    assert places == sorted(places)


def test_wins_are_races_with_place_1(store):
    races = store.races()
    for row in standings.of(store).rows:
        mine = races.entries == row.number
        assert row.wins == int((races.places[mine] == 1).sum())
    assert sum(row.wins for row in standings.of(store).rows) >= len(races.heat)


def test_standings_are_filtered_by_owner_and_kind_without_javascript(client):
    def names(**query: str) -> set[str]:
        return {row["name"] for row in client.get("/api/v1/standings", params=query).json()["rows"]}

    assert names(owner=OWNER) == {NAME}
    assert names(kind="anchor") == {"centerline", "racing_line"}
    assert names(kind="scripted", owner="league") == set()
    page = client.get("/standings", params={"owner": OWNER}).text
    assert "selected" in page and "/drivers/1" not in page


def test_the_player_gets_the_recorded_race_back(client, store):
    heat = rated_heat(store)
    replay = format.decode(store.blobs.get(store.results(heat)[0].replay))
    answer = client.get(f"/api/v1/heats/{heat}/races/1/replay")
    assert int(answer.headers.get("content-length", 0)) < 60_000
    document = answer.json()
    assert [car["name"] for car in document["cars"]] == list(replay.names)
    for car, drawn in enumerate(document["cars"]):
        x = np.cumsum(np.cumsum(drawn["x"])) / 100
        yaw = np.cumsum(drawn["yaw"]) / 100
        assert np.abs(x - replay.columns.x[:, car]).max() < 0.006
        turn = (yaw - replay.columns.yaw[:, car] + np.pi) % (2 * np.pi) - np.pi
        assert np.abs(turn).max() < 0.006
    assert document["events"][0]["text"] == "The race is on"


def test_a_minute_of_eight_cars_reaches_the_player_in_60_kb():
    from dataclasses import replace

    from tests.recorded import raced

    replay = raced()
    frames, cars = 60 * replay.step_hz, 8
    generator = np.random.default_rng(0)
    columns = {}
    for name, scale in (("x", 0.2), ("y", 0.2), ("yaw", 0.1), ("distance", 0.2)):
        steps = scale * generator.random((frames, cars))
        columns[name] = np.cumsum(steps, axis=0)
    for name in ("penalty_s", "laps", "velocity_x", "velocity_y"):
        columns[name] = np.zeros((frames, cars))
    columns["ghost"] = np.zeros((frames, cars), np.bool_)
    columns["checksum"] = np.zeros(frames, np.uint32)
    eight = replace(replay, columns=replace(replay.columns, **columns), names=("driver",) * cars)
    content = json.dumps(player_data(eight), separators=(",", ":")).encode()
    assert len(gzip.compress(content, 6)) < 60_000


@pytest.mark.parametrize(
    "path",
    [
        "/nothing", "/drivers/99", "/drivers/x", "/heats/999", "/heats/1?race=3", "/heats/1?race=x",
        "/heats/99999999999999999999999", "/drivers/99999999999999999999999",
        "/matchups/1/99", "/matchups/1/1", "/matchups/1/2?before=x", "/standings?sort=luck",
        "/standings?page=99", "/heats?driver=99", "/heats?page=99", "/seasons/1?page=x",
        "/static/../app.py", "/static/%2e%2e/app.py", "/static/app.py", "/etc/passwd",
        "/api/v1/heats/1/races/0/replay", "/api/v1/heats/1/races/9/replay", "/api/v1/none",
    ],
)  # fmt: skip
def test_what_is_not_there_is_404_in_one_sentence(client, path):
    answer = client.get(path)
    assert answer.status_code == 404
    if path.startswith("/api"):
        assert answer.json()["error"].endswith(".")
    else:
        assert "<h1>Not Found</h1>" in answer.text
    assert "content-security-policy" in answer.headers


def test_one_lap_page_or_race_is_no_plural(client, store):
    assert "1 lap, 2 cars" in client.get("/").text
    assert "1 lap, 2 cars" in client.get("/standings").text
    heat = lapped_heat(store)
    alone = next(one.number for one in store.heats(("done",)) if len(one.heat.halves) == 1)
    for path, sentence in (
        ("/heats?page=9", "The heats have one page."),
        (f"/heats/{heat}?lap=9", "This race has 1 lap, and no lap '9'."),
        (f"/heats/{heat}?race=9", f"Heat {heat} has no race '9', only 1 and 2."),
        (f"/heats/{alone}?race=9", f"Heat {alone} has no race '9', only 1."),
    ):
        assert client.get(f"/api/v1{path}").json() == {"error": sentence}


@pytest.mark.parametrize("method", ["post", "put", "delete", "patch", "options"])
def test_only_get_and_head_are_answered(client, method):
    assert getattr(client, method)("/standings").status_code == 405
    assert client.head("/standings").status_code == 200
    assert client.head("/standings").content == b""


def test_a_static_file_is_sent_packed_and_only_if_the_browser_has_another_one(client):
    first = client.get("/static/player.js")
    assert (first.status_code, first.headers["content-encoding"]) == (200, "gzip")
    assert first.headers["cache-control"] == "no-cache"
    plain = client.get("/static/player.js", headers={"accept-encoding": "identity"})
    assert "content-encoding" not in plain.headers and plain.content == first.content
    known = {"if-none-match": first.headers["etag"]}
    again = client.get("/static/player.js", headers=known)
    assert (again.status_code, again.content) == (304, b"")
    other = client.get("/static/style.css", headers=known)
    assert other.status_code == 200 and other.headers["etag"] != first.headers["etag"]
    assert client.head("/static/player.js").content == b""


def test_a_server_rarely_looks_through_all_objects_and_leaves_others_alone(store, monkeypatch):
    before, seen = gc.get_threshold(), []
    monkeypatch.setattr("uvicorn.Server.run", lambda *_, **__: seen.append(gc.get_threshold()))
    server.serve(store, 0, ready=seen.append)
    assert seen[1] == (700, 10, 1000)
    assert gc.get_threshold() == before


def test_answers_are_sent_at_once(store, monkeypatch):
    nodelay = []

    def run(_, sockets):
        # As the server's event loop does with a connection.
        async def answer(reader, writer):
            asked = writer.get_extra_info("socket")
            nodelay.append(asked.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
            writer.close()

        async def serve_once():
            async with await asyncio.start_server(answer, sock=sockets[0]):
                reader, writer = await asyncio.open_connection(*sockets[0].getsockname())
                await reader.read()
                writer.close()

        asyncio.run(serve_once())

    monkeypatch.setattr("uvicorn.Server.run", run)
    server.serve(store, 0, ready=lambda url: None)
    assert nodelay == [1]


def test_another_host_name_is_refused(client):
    assert client.get("/", headers={"host": "evil.example"}).status_code == 400


def test_pages_of_a_league_without_races_say_what_to_do(tmp_path):
    with (
        new_league(f"sqlite:///{tmp_path / 'league.db'}", anchors=(), rules=RULES) as store,
        TestClient(make_app(store), base_url=ORIGIN) as client,
    ):
        for path in ("/", "/standings", "/heats", "/live", "/tracks"):
            answer = client.get(path)
            assert answer.status_code == 200
            assert "league run" in answer.text or path == "/tracks"
        # An entry that has not raced has a page, too.
        store.submit("new", "someone", scripted="cautious")
        assert "pending" in client.get("/drivers/1").text


def test_a_race_whose_recording_was_not_kept_has_a_page(tmp_path):
    from league.matchmaking import loop
    from league.matchmaking.loop import Dispatcher
    from league.matchmaking.pairing.matchmaker import Matchmaker
    from tests.matchmaking.season_kit import Here

    anchors = ("centerline", "racing_line")
    with new_league(f"sqlite:///{tmp_path / 'league.db'}", anchors=anchors) as store:
        dispatcher = Dispatcher(store, Here(), keep_replays=False)
        loop.run(store, dispatcher, Matchmaker(store, same_owner=True), heats=2)
        with TestClient(make_app(store), base_url=ORIGIN) as client:
            heat = rated_heat(store)
            assert "No recording was kept" in client.get(f"/heats/{heat}").text
            assert "No recorded race yet" in client.get("/").text


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.0.1", "localhost", "example.org"])
def test_other_addresses_are_refused_with_the_reason(store, host):
    with pytest.raises(ConfigError, match=r"tokens.*--host 127"):
        server.serve(store, 0, host=host, ready=print)


def test_a_port_that_is_taken_is_one_sentence(store, capsys):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert main(["serve", "--league", store.url, "--port", str(port)]) == 2
    assert re.search(r"cannot be opened .*--port", capsys.readouterr().err)
    assert main(["serve", "--league", store.url, "--port", "99999"]) == 2


def test_the_command_serves_until_it_is_interrupted(store):
    command = [sys.executable, "-m", "league.cli", "serve", "--league", store.url, "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            url = re.search(r"http://127\.0\.0\.1:\d+/", process.stdout.readline()).group()
            with urllib.request.urlopen(url, timeout=60) as answer:
                assert b"Standings" in answer.read()
        finally:
            process.send_signal(2)
        assert process.wait(30) in (0, 130)
