"""What is no page: film strips, recordings for the viewer, its files, checkpoints."""

from __future__ import annotations

import gzip
import threading
import time

import cv2
import numpy as np
import pytest
from starlette.testclient import TestClient
from starlette.types import ASGIApp

from league.replay import format
from league.sim.camera.renderer import Renderer
from league.video import stills
from league.web import downloads, reader
from league.web.app import make_app
from league.web.reader import BusyError, Reader
from league.web.security import MOST_SLOW, Access, Limit, Limits
from tests.web.serving import FREE
from tests.web.small_league import ORIGIN, RULES, new_league, rated_heat


@pytest.fixture
def heat(store) -> str:
    return f"/heats/{rated_heat(store)}"


def test_a_film_strip_shows_what_the_car_saw_at_its_moments(client, store, heat):
    answer = client.get(f"{heat}/races/1/cars/2/camera.jpg")
    assert answer.headers["content-type"] == "image/jpeg"
    sheet = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    height, width = stills.STRIP_CAMERA.height, stills.STRIP_CAMERA.width
    assert sheet.shape == (2 * height, 4 * width, 3)
    replay = format.decode(store.blobs.get(store.results(rated_heat(store))[0].replay))
    car = next(car for car in replay.result.order if car.car == 1)
    times_s = stills.strip_moments(car.total_s if car.finished else np.inf, replay.result.race_s)
    sixth = Renderer(replay.tracks, replay.sim, stills.STRIP_CAMERA).render(
        replay.at(np.array(times_s[5:6])), 1
    )[0]
    cell = sheet[height:, width : 2 * width].transpose(2, 0, 1)
    # JPEG changes colours a little; another moment's picture differs by far more.
    assert np.abs(cell.astype(int) - sixth[:3]).mean() < 4
    assert np.abs(sheet[:height, :width].transpose(2, 0, 1).astype(int) - sixth[:3]).mean() > 4


def test_moments_of_a_strip_end_with_the_cars_own_race():
    assert stills.strip_moments(8.0, 20.0) == [0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.5]
    assert stills.strip_moments(np.inf, 16.0)[-1] == 15.0


@pytest.mark.parametrize(
    "path",
    [
        "/heats/999/races/1/cars/1/camera.jpg",
        "{heat}/races/9/cars/1/camera.jpg",
        "{heat}/races/1/cars/0/camera.jpg",
        "{heat}/races/1/cars/3/camera.jpg",
        "{heat}/races/9/race.rrd",
        "{heat}/races/9/rerun",
        "/drivers/99/checkpoint",
        "/rerun/0.0.1/index.html",
        "/rerun/{version}/..%2f..%2fapp.py",
        "/rerun/{version}/app.py",
    ],
)
def test_what_is_not_there_is_404(client, heat, path):
    path = path.format(heat=heat, version=downloads.viewer_version())
    assert client.get(path, follow_redirects=False).status_code == 404


def test_a_driver_is_downloaded_only_if_its_owner_offers_it(tmp_path):
    store = new_league(f"sqlite:///{tmp_path / 'league.db'}", anchors=("centerline",), rules=RULES)
    client = TestClient(make_app(store), base_url=ORIGIN)
    kept = store.submit("kept", "one", weights=b"kept weights")
    offered = store.submit("offered", "two", weights=b"free weights", card={"download": True})
    assert "checkpoint" not in client.get(f"/drivers/{kept.number}").text
    assert client.get(f"/drivers/{kept.number}/checkpoint").status_code == 404
    address = f"/drivers/{offered.number}/checkpoint"
    assert address in client.get(f"/drivers/{offered.number}").text
    answer = client.get(address)
    assert answer.content == b"free weights"
    assert answer.headers["content-disposition"].startswith("attachment")
    assert "default-src 'none'" in answer.headers["content-security-policy"]
    assert client.get("/drivers/1/checkpoint").status_code == 404  # scripted: there is no file
    store.close()


def test_a_recording_for_the_viewer_is_made_once(client, heat):
    first = client.get(f"{heat}/races/1/race.rrd")
    assert first.status_code == 200
    assert first.content[:4] == b"RRF2"
    assert client.get(f"{heat}/races/1/race.rrd").content == first.content


def test_the_viewer_has_a_policy_of_its_own_that_names_its_scripts(client, heat):
    answer = client.get(f"{heat}/races/1/rerun", follow_redirects=False)
    assert answer.status_code == 303
    address = answer.headers["location"]
    assert address.startswith(
        f"/rerun/{downloads.viewer_version()}/index.html?url=http%3A%2F%2F127.0.0.1"
    )
    assert "unsafe" not in answer.headers["content-security-policy"]
    page = client.get(address)
    policy = page.headers["content-security-policy"]
    assert "'wasm-unsafe-eval'" in policy and "unsafe-inline" not in policy
    assert policy.count("'sha256-") == page.text.count("<script>") + page.text.count("<style>")
    assert "https://" not in page.text.split("<body>")[0]
    wasm = client.get(f"/rerun/{downloads.viewer_version()}/re_viewer_bg.wasm")
    assert wasm.headers["content-type"] == "application/wasm"
    assert int(wasm.headers["rerun-final-length"]) == len(wasm.content) > 1e7
    assert int(wasm.headers["content-length"]) < 16e6
    assert "wasm" not in wasm.headers["content-security-policy"]


def test_a_changed_script_is_not_named_by_the_policy():
    page = "<style>a{}</style><script>one()</script><script src='x.js'></script>"
    assert downloads.page_policy(page) != downloads.page_policy(page.replace("one", "two"))
    assert downloads.page_policy(page).count("sha256") == 2


def test_more_slow_requests_than_may_wait_are_asked_to_come_back(store):
    league, going_on, made = Reader(store), threading.Event(), []

    def slow(name: int) -> bytes:
        going_on.wait(60)
        made.append(name)
        return gzip.compress(b"x")

    def ask(name: int) -> None:
        league.large(name % 2, lambda: slow(name))

    threads = [threading.Thread(target=ask, args=(n,)) for n in range(reader.MOST_WAITING)]
    for thread in threads:
        thread.start()
    while league._waiting._value:
        pass
    with pytest.raises(BusyError, match="try again"):
        league.large("another", lambda: b"")
    going_on.set()
    for thread in threads:
        thread.join()
    assert len(made) == 2  # each key once
    assert league.large("another", lambda: b"now") == b"now"


def visitor(app: ASGIApp, host: str) -> TestClient:
    """Return a browser at another address."""
    return TestClient(app, base_url=ORIGIN, client=(host, 5000))


def test_one_client_does_not_keep_the_others_from_slow_answers(store, heat, monkeypatch):
    going_on, answers = threading.Event(), []

    def slow(_store, digest: str) -> bytes:
        going_on.wait(60)
        return digest.encode()

    monkeypatch.setattr(downloads, "rrd_of", slow)
    app = make_app(store, access=Access(limits=FREE))
    greedy, other = (visitor(app, host) for host in ("192.0.2.1", "192.0.2.2"))

    def ask(client: TestClient, race: int) -> None:
        answers.append((client, client.get(f"{heat}/races/{race}/race.rrd").status_code))

    threads = [
        threading.Thread(target=ask, args=(greedy, 1 + number % 2))
        for number in range(2 * reader.MOST_WAITING)
    ]
    for thread in threads:
        thread.start()
    refused = len(threads) - MOST_SLOW
    while len(answers) < refused and any(thread.is_alive() for thread in threads):
        threading.Event().wait(0.01)
    assert answers == [(greedy, 429)] * refused
    last = threading.Thread(target=ask, args=(other, 2))
    last.start()
    last.join(1.0)
    assert last.is_alive()  # it waits for its turn
    going_on.set()
    for thread in (*threads, last):
        thread.join()
    assert (other, 200) in answers and answers.count((greedy, 200)) == MOST_SLOW


def test_the_making_of_slow_answers_is_charged_to_who_asks(store, heat, monkeypatch):
    monkeypatch.setattr(downloads, "rrd_of", lambda *_: time.sleep(0.2) or b"made")
    app = make_app(store, access=Access(limits=Limits(large=Limit(1e-3, 0.1))))
    one, other = (visitor(app, host) for host in ("192.0.2.1", "192.0.2.2"))
    first, second = (f"{heat}/races/{race}/race.rrd" for race in (1, 2))
    assert one.get(first).status_code == 200
    assert one.get(first).status_code == 200  # it is kept
    refused = one.get(second)
    assert refused.status_code == 429 and int(refused.headers["retry-after"]) > 10
    assert one.get("/standings").status_code == 200
    assert other.get(second).status_code == 200
    assert one.get(second).status_code == 200  # another one paid for it
