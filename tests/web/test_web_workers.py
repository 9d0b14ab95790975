"""Workers on other machines: the same heats, the same bits, and what a dishonest one can do."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, replace
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest
from starlette.testclient import TestClient

from league.errors import ConfigError, StoreError
from league.matchmaking import loop, standings, wire
from league.matchmaking.loop import Dispatcher
from league.matchmaking.pairing.heat_spec import Ruleset
from league.matchmaking.remote import Client, RemoteQueue
from league.matchmaking.store import HeatProgress, Store
from league.matchmaking.workers.worker import RaceWorker
from league.sim import PHYSICS
from league.web.app import make_app
from league.web.security import Access
from tests.matchmaking.season_kit import SHORT, Here, followed
from tests.web.serving import FREE, serving
from tests.web.small_league import ORIGIN, queued_league

WORK = "/api/v1/work"


@pytest.fixture
def store(tmp_path) -> Iterator[Store]:
    with queued_league(f"sqlite:///{tmp_path / 'league.db'}") as store:
        yield store


def client_for(store: Store, url: str, owner: str = "lender") -> Client:
    return Client.of(url, store.tokens.create(owner, ("worker",))[0])


def queue_for(store: Store, url: str, folder, owner: str = "lender") -> RemoteQueue:
    return RemoteQueue(client_for(store, url, owner), folder=folder)


def hashes(store: Store) -> list:
    return sorted(
        (record.heat.key, [one.hash for one in store.results(record.number)], record.state)
        for record in store.heats(("done", "quarantined"))
    )


def test_a_remote_worker_makes_the_same_league_as_a_local_one(store, tmp_path):
    with queued_league(f"sqlite:///{tmp_path / 'local.db'}") as local:
        number = len(local.heats())
        loop.run(local, Dispatcher(local, Here()), None, heats=number)
        with serving(store, Access(limits=FREE, audited=0.0)) as url:
            remote = queue_for(store, url, tmp_path / "weights")
            tally = loop.run(None, Dispatcher(remote, Here(2)), None, heats=number)
        assert (tally.heats, tally.failures) == (number, 0)
        assert hashes(store) == hashes(local) and len(hashes(store)) == number
        rows = [
            [(r.name, r.elo, r.races) for r in standings.of(one).rows] for one in (store, local)
        ]
        assert rows[0] == rows[1]
        mine = [one.replay for one in store.results(1)]
        assert mine == [one.replay for one in local.results(1)]  # recordings, too
        assert store.heat(1).worker.startswith("1/lender/")


def test_weights_are_fetched_once_and_kept_by_their_hash(store, tmp_path):
    with serving(store) as url:
        remote = queue_for(store, url, tmp_path / "weights")
        claims = remote.claim("w", 64, lease_s=60.0)
        entry = store.entry("e0")
        got = remote.blobs.get(entry.blob)
        assert got == store.blobs.get(entry.blob)
        (file,) = [one for one in (tmp_path / "weights").rglob("*") if one.is_file()]
        file.write_bytes(b"damaged")
        assert remote.blobs.get(entry.blob) == got  # fetched again
        for claim in claims:
            remote.fail("w", claim.heat.key, "no", lost=True)
    assert remote.blobs.get(entry.blob) == got  # without a server
    with pytest.raises(StoreError, match="cannot be reached"):
        remote.blobs.get("0" * 64)


def test_only_weights_of_heats_that_a_token_holds_are_given_out(store, tmp_path):
    digest = store.entry("e0").blob
    with serving(store) as url:
        remote = queue_for(store, url, tmp_path / "weights")
        with pytest.raises(StoreError, match="No heat that this token holds"):
            remote.blobs.get(digest)
        remote.claim("w", 64, lease_s=60.0)
        other = queue_for(store, url, tmp_path / "others", "other")
        with pytest.raises(StoreError, match="No heat that this token holds"):
            other.blobs.get(digest)
        assert remote.blobs.get(digest)


def test_heats_of_remote_workers_can_be_followed(store, tmp_path):
    with serving(store) as url:
        remote = queue_for(store, url, tmp_path / "weights")
        (claim,) = remote.claim("w", 1, lease_s=60.0)
        *sent, _ = followed(remote, claim)
        remote.show("w", sent[-1:])
        own = [store.shown(claim.number, half) for half in (0, 1)]
        assert tuple(own) == sent[-1].replays and own[0] != own[1]
        queue_for(store, url, tmp_path, "thief").show("w", sent[:1])
        assert [store.shown(claim.number, half) for half in (0, 1)] == own
        player, page = (f"{at}/heats/{claim.number}" for at in (f"{url}/api/v1", url))
        with urlopen(f"{player}/races/1/replay") as answer:
            assert json.load(answer)["over"] is False
        # What is no recording of this race is not shown.
        for false in ((b"x", b"y"), own[::-1]):
            remote.show("w", [HeatProgress(claim.heat.key, tuple(false))])
            assert store.shown(claim.number, 0) == false[0]
            with pytest.raises(HTTPError, match="404"):
                urlopen(f"{player}/races/1/replay?{len(false[0])}")
            with urlopen(f"{page}?{len(false[0])}") as answer:
                assert b"data-replay" not in answer.read()
    remote.show("w", sent[-1:])  # the server is away: no page can follow, and the race goes on


def test_an_owner_is_not_lent_heats_of_own_entries(store, tmp_path):
    with serving(store) as url:
        remote = queue_for(store, url, tmp_path, "owner of e0")
        numbers = {claim.number for claim in remote.claim("w", 64, lease_s=60.0)}
    own = {record.number for record in store.heats(entries=[store.entry("e0").number])}
    assert numbers and own and numbers == {record.number for record in store.heats()} - own


def finished(store: Store, url: str, folder, owner: str, number: int = 8) -> None:
    """Let a remote worker race so many heats."""
    loop.run(None, Dispatcher(queue_for(store, url, folder, owner), Here()), None, heats=number)


def test_a_sample_is_run_again_by_others_and_agrees(store, tmp_path):
    with serving(store, Access(limits=FREE, audited=1.0)) as url:
        rated = store.heats()
        finished(store, url, tmp_path, "lender", len(rated))
        audits = [one for one in store.heats() if one.heat.purpose == "audit"]
        assert {one.heat.audits for one in audits} == {one.heat.key for one in rated} != set()
        again = queue_for(store, url, tmp_path, "lender")  # another token of the same owner
        assert again.claim("w", 64, lease_s=60.0) == []
        finished(store, url, tmp_path, "other", len(audits))
    assert set(store.counts()) == {"done"}


def test_the_sample_is_drawn_by_the_leagues_secret(store):
    loop.run(store, Dispatcher(store, Here()), None, heats=len(store.heats()))
    keys = [one.heat.key for one in store.heats(("done",)) if one.heat.purpose == "rated"]
    assert store.audit(keys, 0.0) == 0
    some = store.audit(keys, 0.5)
    assert 0 < some < len(keys)
    assert store.audit(keys, 0.5) == 0  # sent again, it is the same sample
    assert store.audit(keys, 1.0) == len(keys) - some


def claimed(client: TestClient, headers, **fields) -> dict:
    body = {"worker": "w", "limit": 1, "physics": PHYSICS, **fields}
    answer = client.post(f"{WORK}/claim", json=body, headers=headers)
    assert answer.status_code == 200, answer.text
    return answer.json()


@pytest.fixture
def served(store) -> Iterator[TestClient]:
    app = make_app(store, access=Access(limits=FREE, audited=1.0))
    with TestClient(app, base_url=ORIGIN) as client:
        yield client


def bearer(store: Store, owner: str = "lender") -> dict[str, str]:
    return {"authorization": f"Bearer {store.tokens.create(owner, ('worker',))[0]}"}


def raced(store: Store, key: str) -> dict:
    """Return the honest results of a heat as they are sent."""
    record = store.heat(key)
    dispatcher = Dispatcher(store, Here())
    job = dispatcher._job(replace(record, seeds=store.seeds(record.heat)))
    return wire.sent_heat(RaceWorker().race(job).outcome).model_dump(mode="json")


def given(client: TestClient, headers, heat: dict, worker: str = "w"):
    body = {"worker": worker, "heats": [heat]}
    return client.post(f"{WORK}/complete", json=body, headers=headers)


def test_the_same_results_sent_again_change_nothing(store, served):
    headers = bearer(store)
    key = claimed(served, headers)["heats"][0]["key"]
    heat = raced(store, key)
    assert given(served, headers, heat).json()["accepted"] == [key]
    assert given(served, headers, heat).json()["repeated"] == [key]
    assert len(store.results(store.heat(key).number)) == 2


def test_results_of_a_heat_that_was_lent_to_another_are_left_out(store, served):
    thief, headers = bearer(store, "thief"), bearer(store)
    key = claimed(served, headers)["heats"][0]["key"]
    heat = raced(store, key)
    assert given(served, thief, heat).json() == {
        "accepted": [], "repeated": [key], "quarantined": [], "unverified": []
    }  # fmt: skip
    assert given(served, headers, heat, worker="v").json()["repeated"] == [key]
    assert store.results(store.heat(key).number) == []
    assert served.post(f"{WORK}/fail", json={"worker": "w", "key": key}, headers=thief).json() == {
        "state": "claimed"
    }
    beat = {"worker": "w", "keys": [key]}
    assert served.post(f"{WORK}/heartbeat", json=beat, headers=thief).json() == {"keys": []}
    assert served.post(f"{WORK}/heartbeat", json=beat, headers=headers).json() == {"keys": [key]}


def without(race: dict, name: str) -> dict:
    return {key: value for key, value in race["result"].items() if key != name}


LIES = {
    "another winner": lambda race: {**race, "places": race["places"][::-1]},
    "places that no car has": lambda race: {**race, "places": [1, 9]},
    "a place too few": lambda race: {**race, "places": [1]},
    "other lap times": lambda race: {
        **race, "result": {**race["result"], "race_s": race["result"]["race_s"] / 2}
    },
    "no classification": lambda race: {**race, "result": without(race, "order")},
    "numbers as texts": lambda race: {
        **race, "result": {**race["result"], "steps": str(race["result"]["steps"])}
    },
    "truths as numbers": lambda race: {**race, "result": {**race["result"], "lead_changes": False}},
    "something else": lambda race: {**race, "result": {**race["result"], "note": "<script>"}},
    "not a number": lambda race: {**race, "result": {**race["result"], "race_s": float("nan")}},
    "a recording that is none": lambda race: {**race, "replay": "AAAA"},
    "a recording that is no Base64": lambda race: {**race, "replay": "é*"},
    "a deep result": lambda race: {**race, "result": json.loads("[" * 500 + "]" * 500)},
}  # fmt: skip


@pytest.mark.parametrize("lie", LIES)
def test_results_that_contradict_their_recording_are_refused(store, served, lie):
    headers = bearer(store)
    key = claimed(served, headers)["heats"][0]["key"]
    heat = raced(store, key)
    races = [LIES[lie](heat["races"][0]), *heat["races"][1:]]
    answer = served.post(
        f"{WORK}/complete",
        content=json.dumps({"worker": "w", "heats": [{**heat, "races": races}]}),
        headers=headers,
    )
    assert answer.status_code == 422, answer.text
    assert answer.json()["error"].endswith(".") and len(answer.json()["error"]) < 600
    assert store.results(store.heat(key).number) == [] and store.counts()["claimed"] == 1


def test_the_recording_of_another_race_is_refused(store, served):
    headers = bearer(store)
    key = claimed(served, headers)["heats"][0]["key"]
    heat = raced(store, key)
    races = [{**heat["races"][0], **heat["races"][1]}, heat["races"][1]]
    answer = given(served, headers, {**heat, "races": races})
    assert answer.status_code == 422 and "of another race" in answer.json()["error"]


def test_a_planar_result_cannot_excuse_itself_with_a_machine(store, served):
    headers = bearer(store)
    key = claimed(served, headers)["heats"][0]["key"]
    answer = given(served, headers, {**raced(store, key), "machine": "mine"})
    assert answer.status_code == 422 and "planar" in answer.json()["error"]


def test_a_result_made_up_without_a_recording_is_found_by_the_audit(store, served):
    headers = bearer(store)
    lent = claimed(served, headers)["heats"][0]
    heat = raced(store, lent["key"])
    forged = [{**race, "places": race["places"][::-1], "replay": ""} for race in heat["races"]]
    assert given(served, headers, {**heat, "races": forged}).json()["accepted"] == [lent["key"]]
    (audit,) = [one for one in store.heats(("planned",)) if one.heat.purpose == "audit"]
    loop.run(store, Dispatcher(store, Here()), None, heats=store.counts()["planned"])
    assert store.heat(lent["key"]).state == store.heat(audit.number).state == "quarantined"
    assert not (store.races(rated=None).heat == lent["number"]).any()


def test_a_lease_ends_with_its_worker(store, served):
    headers = bearer(store)
    lent = claimed(served, headers, lease_s=1.0)["heats"][0]
    store._database._clock = lambda: 4e9
    assert lent["key"] in [one.heat.key for one in store.claim("local", 64)]


def test_a_token_holds_so_many_heats_at_a_time(store, served, monkeypatch):
    from league.web import token_api

    monkeypatch.setattr(token_api, "MOST_HELD", 3)
    headers = bearer(store)
    assert len(claimed(served, headers, limit=2)["heats"]) == 2
    assert len(claimed(served, headers, limit=2, worker="v")["heats"]) == 1
    assert claimed(served, headers, limit=2)["heats"] == []
    assert len(claimed(served, bearer(store, "other"), limit=2)["heats"]) == 2


def test_a_worker_of_another_version_is_turned_away(store, served):
    body = {"worker": "w", "physics": "0"}
    answer = served.post(f"{WORK}/claim", json=body, headers=bearer(store))
    assert answer.status_code == 409 and "this worker has 0" in answer.json()["error"]
    assert store.counts().keys() == {"planned"}


@pytest.mark.parametrize(
    "body",
    [
        b"", b"{", b"[]", b"null", b"{}", b'{"worker": 7}', b'{"worker": "a b", "physics": "5"}',
        b'{"worker": "w", "physics": "5", "limit": 1e9}', 
        b'{"worker": "w", "physics": "5", "x": 1}',
        b'{"worker": "w", "physics": "5", "lease_s": NaN}', b"\xff", b"[" * 100_000,
        b'{"worker": "\\u0000", "physics": "5"}', b'{"worker": "../../x", "physics": "5"}',
    ],
)  # fmt: skip
def test_requests_that_make_no_sense_are_one_sentence(store, served, body):
    for what in ("claim", "heartbeat", "complete", "fail"):
        answer = served.post(f"{WORK}/{what}", content=body, headers=bearer(store))
        assert answer.status_code == 422 and answer.json()["error"].endswith("openapi.json.")
    assert store.counts().keys() == {"planned"}


def test_a_tokens_scope_is_checked_and_a_submitter_is_no_worker(store, served):
    secret, _ = store.tokens.create("ann", ("submit",))
    headers = {"authorization": f"Bearer {secret}"}
    for what in ("claim", "heartbeat", "complete", "fail"):
        assert served.post(f"{WORK}/{what}", json={}, headers=headers).status_code == 403
    assert served.get(f"{WORK}/weights", params={"digest": "0"}, headers=headers).status_code == 403


def test_a_worker_waits_for_a_server_that_comes_back(store, tmp_path):
    with serving(store) as url:
        client = client_for(store, url)
    waits = []

    def back(seconds: float) -> None:
        waits.append(seconds)
        if len(waits) > 3:
            raise KeyboardInterrupt

    patient = replace(client, patience_s=1000.0, sleep=back)
    with pytest.raises(KeyboardInterrupt):
        RemoteQueue(patient, folder=tmp_path).claim("w", 1, lease_s=60.0)
    assert waits == [1.0, 2.0, 4.0, 8.0]
    with pytest.raises(StoreError, match="cannot be reached"):
        RemoteQueue(client, folder=tmp_path).claim("w", 1, lease_s=60.0)


@pytest.mark.parametrize(
    ("url", "token", "message"),
    [
        ("ftp://x", "t", "no address of a served league"),
        ("example.org", "t", "no address of a served league"),
        ("https://user:pw@example.org", "t", "no address of a served league"),
        ("https://example.org", "", "LEAGUE_TOKEN"),
        ("https://example.org", "league_" + "\n" * 43, "not the form"),
        ("http://example.org", "league_" + "x" * 43, "travel readable to example.org"),
    ],
)
def test_an_address_or_token_that_cannot_be_is_one_sentence(url, token, message):
    with pytest.raises(ConfigError, match=message) as refusal:
        Client.of(url, token)
    assert "x" * 43 not in str(refusal.value) and "\n" not in str(refusal.value)
    assert "x" * 43 not in repr(Client.of("https://example.org", "league_" + "x" * 43))


def test_rulesets_travel_whole():
    rules = replace(SHORT, tracks=("reinvent_2018", "oval"), obstacles=2)
    sent = wire.Lent(rulesets={rules.hash: json.loads(json.dumps(asdict(rules)))})
    assert (
        Ruleset.of(wire.Lent.model_validate_json(sent.model_dump_json()).rulesets[rules.hash])
        == rules
    )
