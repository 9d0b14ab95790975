"""Workers: an outcome follows from its job, places follow the rules, failures are reported."""

from __future__ import annotations

import math
import os
import platform
import resource
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import psycopg
import pytest

from league.cli.season.run import describe
from league.errors import StoreError
from league.matchmaking.loop import MOST_LOSSES, Dispatcher, FinishedHeat, Tally, heat_driver
from league.matchmaking.pairing import heat_spec, matchmaker
from league.matchmaking.pairing.heat_spec import Half
from league.matchmaking.store import HeatProgress, Store, create
from league.matchmaking.workers.worker import (
    HeatJob,
    HeatReport,
    RaceWorker,
    machine_class,
    places,
)
from league.race_spec import CarResult, Entry, Event, RaceResult, RaceSpec
from league.replay import format as replay_format
from tests.matchmaking import leagues
from tests.matchmaking.season_kit import SHORT, Here, new_league, submitted


@pytest.fixture
def league(tmp_path):
    with new_league(f"sqlite:///{tmp_path / 'league.db'}") as store:
        submitted(store, "bob", seed=1)
        yield store


def job(store: Store, one: str, other: str, **settings) -> HeatJob:
    entries = [store.entry(name) for name in (one, other)]
    heat = heat_spec.mirrored(SHORT.hash, ("reinvent_2018",) * 2, tuple(e.id for e in entries))
    field = {entry.id: heat_driver(store, entry) for entry in entries}
    return HeatJob(heat.key, 1, heat.halves, (3, 4), SHORT, field, **settings)


def test_a_heat_that_is_followed_sends_its_recordings_so_far_and_ends_the_same(league, monkeypatch):
    given = job(league, "centerline", "bob")
    monkeypatch.setattr("league.matchmaking.workers.worker.SHOWN_EVERY_S", math.inf)
    (alone,) = RaceWorker().follow(given)
    monkeypatch.setattr("league.matchmaking.workers.worker.SHOWN_EVERY_S", 0.0)
    *sent, report = RaceWorker().follow(given)
    assert isinstance(report, HeatReport) and isinstance(alone, HeatReport)
    assert report.outcome is not None and report.outcome == alone.outcome
    assert len(sent) == 9
    for steps, one in enumerate(sent, 1):
        assert isinstance(one, HeatProgress) and one.key == given.key
        for race, content in zip(report.outcome.races, one.replays, strict=True):
            so_far, whole = replay_format.decode(content), replay_format.decode(race.replay)
            assert so_far.num_frames == steps + 1 == so_far.result.steps + 1
            assert np.array_equal(so_far.columns.checksum, whole.columns.checksum[: steps + 1])
            assert so_far.spec == whole.spec


def test_a_job_gives_the_same_outcome_in_a_fresh_pit_and_in_a_used_one(league):
    submitted(league, "ann")
    given = job(league, "ann", "bob")
    worker = RaceWorker()
    first, second, fresh = worker.race(given), worker.race(given), RaceWorker().race(given)
    assert first.outcome is not None and first.traceback == ""
    assert first.outcome == second.outcome == fresh.outcome
    assert {race.result["steps"] for race in first.outcome.races} == {9}


def test_a_race_in_bullet_names_the_class_of_machine_that_gave_its_bits(league):
    planar = job(league, "bob", "centerline")
    bullet = replace(planar, ruleset=replace(SHORT, solver="bullet"))
    outcomes = [RaceWorker().race(one).outcome for one in (planar, bullet)]
    assert [one and one.machine for one in outcomes] == ["", machine_class()]
    architecture, engine, libm = machine_class().split()
    assert architecture == platform.machine() and len(libm) == len("libm:") + 12
    assert engine.startswith("pybullet:") and len(engine) == len("pybullet:") + 12


@pytest.mark.skipif(
    platform.machine() != "x86_64" or platform.libc_ver()[0] != "glibc", reason="tunes glibc"
)
def test_a_class_of_machine_follows_what_libm_answers_and_not_what_the_processor_can():
    def elsewhere(disabled: str) -> str:
        code = "from league.matchmaking.workers.worker import machine_class; print(machine_class())"
        tuned = {**os.environ, "GLIBC_TUNABLES": f"glibc.cpu.hwcaps={disabled}"}
        return subprocess.check_output([sys.executable, "-c", code], env=tuned, text=True).strip()

    assert elsewhere("-AVX512F") == machine_class()
    if "fma" in Path("/proc/cpuinfo").read_text(encoding="utf-8").split():
        plain = elsewhere("-AVX512F,-AVX2,-AVX,-FMA,-FMA4")
        assert plain.split()[:2] == machine_class().split()[:2]
        assert plain != machine_class()  # libm rounds in another way without fused sums


def test_a_replay_names_the_policy_by_the_digest_of_its_checkpoint(league):
    entry = submitted(league, "ann")
    outcome = RaceWorker().race(job(league, "ann", "bob")).outcome
    assert outcome is not None and outcome.races[0].replay is not None
    spec = replay_format.decode(outcome.races[0].replay).spec
    assert [one.name for one in spec.entries] == ["ann", "bob"]
    assert spec.entries[0].digest == entry.card["digest"] and spec.seed == 3


def test_without_its_recording_a_race_has_the_same_hash(league):
    kept = RaceWorker().race(job(league, "centerline", "bob")).outcome
    bare = RaceWorker().race(job(league, "centerline", "bob", keep_replays=False)).outcome
    assert kept is not None and bare is not None
    assert [race.replay for race in bare.races] == [None, None]
    assert [race.hash for race in bare.races] == [race.hash for race in kept.races]


def test_another_seed_leaves_another_trace(league):
    given = job(league, "centerline", "bob")
    other = replace(given, halves=given.halves[:1], seeds=(99,))
    one = RaceWorker().race(given).outcome, RaceWorker().race(other).outcome
    assert one[0].races[0].result["trace"] != one[1].races[0].result["trace"]


def test_an_entry_may_race_itself(league):
    entry = submitted(league, "ann")
    given = job(league, "ann", "bob")
    own = replace(given, halves=(Half("reinvent_2018", (entry.id,) * 2),), seeds=(1,))
    outcome = RaceWorker().race(own).outcome
    assert outcome is not None and sorted(outcome.races[0].places) in ([1, 2], [1, 1])


def test_what_goes_wrong_in_a_job_is_reported_with_its_traceback(league):
    given = replace(job(league, "centerline", "bob"), halves=(Half("atlantis", ()),) * 2)
    report = RaceWorker().race(given)
    assert report.outcome is None
    assert "Traceback" in report.traceback and "atlantis" in report.traceback


def car(slot: int, **fields) -> CarResult:
    counts = dict.fromkeys(
        ("off_tracks", "crashes", "contacts_taken", "immobilised", "reversed", "overtakes"), 0
    )
    given = {"finished": True, "laps": 3, "total_s": 20.0, "distance": 60.0, **fields}
    return CarResult(
        car=slot, name="x", place=1, lap_times_s=(), penalty_s=0.0, **{**counts, **given}
    )


def result(*cars: CarResult, events: tuple[Event, ...] = ()) -> RaceResult:
    entries = tuple(Entry(name="x") for _ in cars)
    return RaceResult(
        spec=RaceSpec(entries=entries), order=cars, steps=600, race_s=40.0, lead_changes=0,
        events=events,
    )  # fmt: skip


def test_finishers_are_placed_by_time_and_share_a_place_when_equal():
    found = places(result(car(2, total_s=21.0), car(0, total_s=20.0), car(1, total_s=20.0)))
    assert found == (1, 1, 3)


def test_those_who_did_not_finish_are_placed_by_laps_then_distance():
    out = {"finished": False, "total_s": 40.0}
    found = places(
        result(
            car(0, **out, laps=1, distance=30.0),
            car(1, **out, laps=2, distance=41.0),
            car(2, **out, laps=2, distance=42.0),
            car(3, total_s=39.0),
        )
    )
    assert found == (4, 3, 2, 1)


def test_of_two_that_failed_at_the_same_place_the_one_that_lasted_longer_is_ahead():
    out = {"finished": False, "total_s": 40.0, "laps": 0, "distance": 5.0}
    faults = tuple(
        Event(time_s=when, kind="driver_fault", car=slot, value=count)
        for slot, when, count in ((0, 2.0, 25.0), (1, 3.0, 25.0), (0, 1.0, 3.0))
    )
    assert places(result(car(0, **out), car(1, **out), events=faults)) == (2, 1)
    # A car with forgiven faults drove to the end.
    forgiven = (Event(time_s=1.0, kind="driver_fault", car=0, value=3.0), faults[1])
    assert places(result(car(0, **out), car(1, **out), events=forgiven)) == (1, 2)
    assert places(result(car(0, **out), car(1, **out))) == (1, 1)


def test_finishers_come_before_those_who_drove_further_without_a_finish():
    out = {"finished": False, "total_s": 10.0}
    cars = (
        car(0, **out, laps=2, distance=40.0),
        car(1, total_s=31.5),
        car(2, total_s=30.0),
        car(3, total_s=31.5),
        car(4, **out, laps=2, distance=41.0),
        car(5, **out, laps=1, distance=99.0),
        car(6, **out, laps=2, distance=40.0),
    )
    assert places(result(*cars)) == (5, 2, 1, 2, 4, 7, 5)


def test_a_dispatcher_hands_in_what_its_workers_raced(league):
    given = job(league, "centerline", "bob")
    heat = heat_spec.mirrored(SHORT.hash, ("reinvent_2018",) * 2, tuple(given.drivers))
    league.plan([heat])
    dispatcher = Dispatcher(league, Here())
    (ended,) = dispatcher.step(0.0)
    assert ended.became == "accepted" and not dispatcher.running
    assert league.heat(1).state == "done" and len(league.races().heat) == 2
    replay = league.results(1)[0].replay
    assert replay is not None and leagues.keeps(league, replay)


class Suspended(Here):
    """Workers on a machine that sleeps, longer than a lease, while they race their first job."""

    def __init__(self, num_workers: int) -> None:
        super().__init__(num_workers)
        self._asleep = True

    def wait(self, timeout_s: float) -> list[HeatReport]:
        if self._asleep:
            self._asleep = False
            time.sleep(0.2)
            return []
        return super().wait(timeout_s)


def test_a_dispatcher_that_slept_longer_than_its_lease_goes_on_with_its_own_heat(league):
    given = job(league, "centerline", "bob")
    league.plan([heat_spec.mirrored(SHORT.hash, ("reinvent_2018",) * 2, tuple(given.drivers))])
    workers = Suspended(2)
    dispatcher = Dispatcher(league, workers, lease_s=0.1)
    assert dispatcher.step(0.0) == []
    (finished,) = dispatcher.step(0.0)
    assert finished.became == "accepted" and not dispatcher.running
    assert workers.jobs == []  # it was not raced twice
    assert dispatcher.step(0.0) == [] and league.counts() == {"done": 1}


def test_a_report_on_a_heat_that_is_not_raced_is_discarded_with_a_message(league, caplog):
    class Confused(Here):
        def wait(self, timeout_s: float) -> list[HeatReport]:
            return [HeatReport("0" * 64, None, "late")]

    assert Dispatcher(league, Confused()).step(0.0) == []
    assert "discarded a late report on heat 000000" in caplog.text


class Broken(Here):
    """Workers that lose every job."""

    def wait(self, timeout_s: float) -> list[HeatReport]:
        return [HeatReport(self.jobs.pop(0).key, None, "the dog ate it")] if self.jobs else []


def test_a_heat_that_fails_three_times_is_an_error_with_its_traceback(league):
    given = job(league, "centerline", "bob")
    league.plan([heat_spec.mirrored(SHORT.hash, ("reinvent_2018",) * 2, tuple(given.drivers))])
    dispatcher = Dispatcher(league, Broken())
    assert [dispatcher.step(0.0)[0].became for _ in range(3)] == ["planned", "planned", "error"]
    assert dispatcher.step(0.0) == []
    assert league.heat(1).traceback == "the dog ate it" and not len(league.races().heat)
    assert league.retry(league.heat(1).heat.key)
    assert Dispatcher(league, Here()).step(0.0)[0].became == "accepted"


class Killed(Here):
    """Workers that are killed with every job."""

    def wait(self, timeout_s: float) -> list[HeatReport]:
        return [HeatReport(self.jobs.pop(0).key, None, "killed", lost=True)] if self.jobs else []


def test_a_heat_whose_workers_are_killed_is_raced_again_within_reason(league):
    given = job(league, "centerline", "bob")
    league.plan([heat_spec.mirrored(SHORT.hash, ("reinvent_2018",) * 2, tuple(given.drivers))])
    dispatcher = Dispatcher(league, Killed())
    ended, tally = [dispatcher.step(0.0)[0] for _ in range(MOST_LOSSES + 2)], Tally()
    assert {one.became for one in ended} == {"planned"}
    for one in ended:
        tally.add(one)
    assert league.heat(1).attempts == tally.failures == 2
    assert "bob: interrupted, will be tried again: killed" in describe(ended[0])
    assert "bob: failed, will be tried again: killed" in describe(ended[-1])
    assert dispatcher.step(0.0)[0].became == "error"  # a race that always ends its worker


def test_a_damaged_blob_fails_its_heat_and_not_the_season(league, tmp_path):
    ann = submitted(league, "ann", senses="blind")
    tracks = ("reinvent_2018",) * 2
    jobs = [job(league, "ann", "bob"), job(league, "centerline", "bob")]
    league.plan([heat_spec.mirrored(SHORT.hash, tracks, tuple(one.drivers)) for one in jobs])
    with closing(sqlite3.connect(tmp_path / "league.db")) as database, database:
        there = "update blobs set content = zeroblob(length(content)) where digest = ?"
        assert database.execute(there, [ann.blob]).rowcount == 1
    ended = Dispatcher(league, Here(2)).step(0.0)
    assert [one.became for one in ended] == ["planned", "accepted"]
    assert "is damaged (its hash differs)" in ended[0].report.traceback
    assert len(league.races().heat) == 2


def test_a_heat_of_another_physics_is_not_raced(league, monkeypatch):
    given = job(league, "centerline", "bob")
    league.plan([heat_spec.mirrored(SHORT.hash, ("reinvent_2018",) * 2, tuple(given.drivers))])
    monkeypatch.setattr("league.matchmaking.workers.worker.PHYSICS", "another")
    (ended,) = Dispatcher(league, Here()).step(0.0)
    assert ended.became == "planned" and "use the version" in ended.report.traceback


class HereUntilFull(Here):
    """Workers that end when no file may grow any more: the limit stands for the disk.

    Python ignores the signal that comes with it, so a write fails as on a full disk.
    """

    def wait(self, timeout_s: float) -> list[HeatReport]:
        reports = super().wait(timeout_s)
        most = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
        resource.setrlimit(resource.RLIMIT_FSIZE, (10, most))
        return reports


def test_no_room_for_recordings_is_reported_and_the_heat_is_raced_again_when_there_is(tmp_path):
    """Recordings come first: a heat is not done before its recording is safe."""
    blobs = tmp_path / "blobs"
    url = f"sqlite:///{tmp_path / 'league.db'}"
    with create(url, ruleset=SHORT, blobs=str(blobs)) as store:
        matchmaker.enter_anchors(store, ["centerline"])
        _one_heat(store)
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        try:
            with pytest.raises(StoreError, match=r"cannot be written .* has room"):
                Dispatcher(store, HereUntilFull(), lease_s=0.05).step(0.0)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        assert store.counts() == {"claimed": 1} and not len(store.races().heat)
        assert [path for path in blobs.rglob(".*")] == []  # no part of a file is left
        _raced_by_another(store)
        assert leagues.keeps(store, store.results(1)[0].replay or "")


FULL = """
CREATE FUNCTION full_disk() RETURNS trigger AS $$ BEGIN
    RAISE EXCEPTION 'could not extend file' USING ERRCODE = 'disk_full';
END $$ LANGUAGE plpgsql;
CREATE TRIGGER full_disk BEFORE INSERT ON results EXECUTE FUNCTION full_disk()
"""
"""Have PostgreSQL answer as it does when it finds no room for results."""


def test_a_full_postgresql_is_reported_and_the_heat_is_raced_again_when_there_is_room(new_postgres):
    url = new_postgres()
    with new_league(url) as store, psycopg.connect(url, autocommit=True) as server:
        _one_heat(store)
        before = len(leagues.events(store))
        server.execute(FULL)
        sentence = "cannot grow, the server's disk is full: free some space; nothing was changed$"
        with pytest.raises(StoreError, match=sentence):
            Dispatcher(store, Here(), lease_s=0.05).step(0.0)
        assert store.counts() == {"claimed": 1} and not len(store.races().heat)
        assert [event.action for event in leagues.events(store)[before:]] == ["claim"]
        server.execute("DROP TRIGGER full_disk ON results")
        _raced_by_another(store)


def _one_heat(store: Store) -> None:
    submitted(store, "ann", senses="blind")
    one, other = (entry.id for entry in store.entries())
    track = "reinvent_2018"
    store.plan([heat_spec.mirrored(SHORT.hash, (track, track), (one, other))])


def _raced_by_another(store: Store) -> None:
    """Race the one heat that was left, once its lease is over; that is no failed try."""
    ended: list[FinishedHeat] = []
    heir, give_up = Dispatcher(store, Here()), time.monotonic() + 30
    while not ended and time.monotonic() < give_up:
        ended = heir.step(0.0)
        time.sleep(0.01)
    assert [one.became for one in ended] == ["accepted"]
    assert store.heat(1).attempts == 1 and len(store.races().heat) == 2
