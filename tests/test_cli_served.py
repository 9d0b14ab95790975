"""Tokens, submitting to a served league, packing and serving, as a person types them."""

from __future__ import annotations

import json
import re
import socket
import threading
from collections.abc import Iterator
from contextlib import closing
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import ClassVar

import pytest

from league.agents import checkpoint
from league.cli import main
from league.matchmaking import submission
from league.matchmaking.store import Store
from tests.agents.trained import make_checkpoint
from tests.matchmaking.season_kit import new_league
from tests.web.serving import serving


@pytest.fixture
def store(tmp_path, monkeypatch) -> Iterator[Store]:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("LEAGUE_TOKEN", raising=False)
    monkeypatch.setenv("LEAGUE_URL", f"sqlite:///{tmp_path / 'league.db'}")
    checkpoint.save("mine.pt", make_checkpoint("blind", name="mine"))
    with new_league(f"sqlite:///{tmp_path / 'league.db'}") as store:
        yield store


@pytest.fixture
def said(capsys):
    """Return what a command prints, given its exit code."""

    def run(*command: str, code: int = 0) -> str:
        capsys.readouterr()
        assert main(list(command)) == code
        printed = capsys.readouterr()
        return printed.err if code == 2 else printed.out

    return run


def test_a_token_is_made_listed_and_revoked(store, said):
    secret, about = said("token", "create", "ann", "--scope", "worker", "--days", "2").splitlines()
    assert store.tokens.find(secret).scopes == ("worker",)
    assert about.startswith("Token 1 of ann: worker; ends 20") and "only now" in about
    said("token", "create", "bob", "--days", "0")
    (first, second) = json.loads(said("token", "list", "--json"))
    assert (first["owner"], second["expires_s"]) == ("ann", None)
    assert first["expires_s"] - first["created_s"] == pytest.approx(2 * 86400)
    listed = said("token", "list")
    assert "active" in listed and secret not in listed
    assert said("token", "revoke", secret) == "Token 1 of ann is revoked.\n"
    assert "revoked" in said("token", "list") and store.tokens.find(secret) is None
    assert "--days -1" in said("token", "create", "ann", "--days", "-1", code=2)
    assert "no such token" in said("token", "revoke", "9", code=2)


def test_a_checkpoint_is_submitted_to_a_served_league_and_retired_there(store, said, monkeypatch):
    secret, _ = store.tokens.create("ann", ("submit",))
    with serving(store) as url:
        monkeypatch.setenv("LEAGUE_TOKEN", secret)
        monkeypatch.delenv("LEAGUE_URL")
        out = said("submit", "mine.pt", "--to", f"{url}/", "--name", "Ann's car")
        assert "Ann's car by ann: entry" in out and f"{url}/drivers/2" in out
        again = said("submit", "mine.pt", "--to", url, "--name", "other")
        assert "entered already, as Ann's car" in again
        late = said("submit", "mine.pt", "--to", url, "--name", "Ann's car", "--download")
        assert "cannot be downloaded" in late and not store.entry("Ann's car").downloadable
        checkpoint.save("free.pt", make_checkpoint("blind", seed=1))
        offered = said("submit", "free.pt", "--to", url, "--download")
        assert "cannot be downloaded" not in offered and store.entry("free").downloadable
        assert "'mine' cannot" not in said("retire", "Ann's car", "--yes", "--to", url)
        assert said("retire", "Ann's car", "--yes", "--to", url).endswith("retired already.\n")
        assert "it cannot come back" in said("submit", "mine.pt", "--to", url, code=2)
        assert "only its owner's token" in said(
            "retire", "centerline", "--yes", "--to", url, code=2
        )
        assert "no terminal" in said("retire", "Ann's car", "--to", url, code=2)
        with monkeypatch.context() as asked:
            asked.setattr("sys.stdin.isatty", lambda: True)
            asked.setattr("builtins.input", lambda question: "no")
            assert said("retire", "free", "--to", url, code=1) == "free stays as it is.\n"
        assert store.entry("free").state == "pending"
        assert "already" not in said("submit", "free.pt", "--to", url)
        store.move({store.entry("free").id: "validating"})
        assert "free by ann is entered already: " in said("submit", "free.pt", "--to", url)
        assert "scripted driver" in said("submit", "cautious", "--to", url, code=2)
        assert "leave it out" in said("submit", "mine.pt", "--to", url, "--owner", "x", code=2)
        wrong = said("submit", "mine.pt", "--to", url, "--token", secret[:-1] + "!", code=2)
        assert "not the form" in wrong and secret[:-1] not in wrong
        other = "league_" + "A" * 43
        refused = said("submit", "mine.pt", "--to", url, "--token", other, code=2)
        assert "not known" in refused and other not in refused
    assert (store.entry("Ann's car").state, store.entry("Ann's car").owner) == ("retired", "ann")
    assert "cannot be reached" in said("submit", "mine.pt", "--to", url, code=2)
    monkeypatch.delenv("LEAGUE_TOKEN")
    assert "LEAGUE_TOKEN" in said("submit", "mine.pt", "--to", url, code=2)


def test_a_remote_worker_ends_at_once_without_a_league_or_a_token(store, said, monkeypatch):
    secret, _ = store.tokens.create("ann", ("submit",))
    with serving(store) as url:
        refused = said("work", "--to", url, "--token", secret, "--workers", "1", code=2)
        assert "needs the scope worker" in refused
    assert "cannot be reached" in said("work", "--to", url, "--token", secret, code=2)
    assert "1 to 600 s" in said("work", "--to", url, "--lease-s", "900", code=2)


class Strange(BaseHTTPRequestHandler):
    """A server that is no league."""

    answers = (
        (302, b"", {"Location": "http://evil.example/"}),
        (200, b"hello", {}),
        (500, b"<html>", {}),
        (422, b'{"error": "red\\u001b[2J."}', {}),
    )
    seen: ClassVar[list[str]] = []

    def do_POST(self) -> None:
        self.rfile.read(int(self.headers["content-length"]))
        status, body, headers = self.answers[len(self.seen)]
        self.seen.append(self.path)
        self.send_response(status)
        for name, value in {**headers, "Content-Length": str(len(body))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        pass


def test_a_server_that_is_no_league_gets_one_sentence_and_no_redirect_is_followed(store, said):
    Strange.seen.clear()
    with HTTPServer(("127.0.0.1", 0), Strange) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        url = f"http://127.0.0.1:{server.server_port}"
        command = ("submit", "mine.pt", "--to", url, "--token", "league_" + "x" * 43)
        found = [said(*command, code=2) for _ in Strange.answers]
        server.shutdown()
        thread.join()
    assert "is now 'http://evil.example/': give that address" in found[0]
    assert "answers as no league does" in found[1]
    assert "answers 500 Internal Server Error: is a league served there?" in found[2]
    assert found[3] == "league: red?[2J\n"


def test_a_packed_checkpoint_is_what_the_server_takes(store, said, tmp_path):
    assert said("pack", "mine.pt").startswith("mine.safetensors: ")
    content = (tmp_path / "mine.safetensors").read_bytes()
    assert content == submission.pack(checkpoint.load("mine.pt"))
    assert said("pack", "mine.pt", "--out", "a/b.safetensors").startswith("a/b.safetensors: ")
    assert "has no weights" in said("pack", "cautious", code=2)
    assert submission.accept(store, content, "mine", "ann").state == "pending"


def test_serving_other_machines_needs_tokens_and_names(store, said):
    assert "it has no tokens" in said("serve", "--host", "0.0.0.0", "--port", "0", code=2)
    store.tokens.create("ann", ("submit",))
    assert "say with --name" in said("serve", "--host", "0.0.0.0", "--port", "0", code=2)
    assert "cannot be opened" in said("serve", "--host", "192.0.2.1", "--port", "0", code=2)
    store.tokens.revoke("1")
    assert "it has no tokens" in said("serve", "--host", "0.0.0.0", "--name", "x", code=2)
    assert "--entries -1: give 0 or more" in said("serve", "--entries", "-1", code=2)
    assert "--audit '200%' is no share" in said("serve", "--audit", "200%", code=2)


def test_a_public_name_is_answered_and_no_other(store, monkeypatch):
    import uvicorn
    from starlette.testclient import TestClient

    from league.web import server
    from league.web.security import Access

    store.tokens.create("ann", ("submit",))
    served = {}

    def run(self: uvicorn.Server, sockets: list[socket.socket]) -> None:
        served["app"], served["address"] = self.config.app, sockets[0].getsockname()[0]

    monkeypatch.setattr(uvicorn.Server, "run", run)
    access = Access(hosts=("127.0.0.1", "localhost", "league.example.org"))
    with closing(store):
        server.serve(store, 0, host="0.0.0.0", access=access, ready=lambda url: None)
        assert served["address"] == "0.0.0.0"
        client = TestClient(served["app"], base_url="http://league.example.org")
        assert client.get("/submit").status_code == 200
        assert "https://league.example.org" not in client.get("/submit").text
        assert client.get("/submit", headers={"host": "evil.example"}).status_code == 400


def test_the_help_names_the_new_commands(said):
    text = said("--help")
    assert re.search(r"^  token +Make", text, re.MULTILINE) and "  pack " in text
