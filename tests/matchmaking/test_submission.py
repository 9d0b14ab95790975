"""Submissions: what an owner packs is what the league reads, and nothing hostile gets in."""

from __future__ import annotations

import json
import random
import resource
import struct
import time
from dataclasses import replace

import numpy as np
import pytest
from safetensors.numpy import load as safetensors_load

from league.agents import checkpoint
from league.agents.checkpoint import Card, Checkpoint
from league.agents.network import NetworkConfig
from league.errors import LeagueError, PolicyError, StoreError
from league.matchmaking import submission
from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Ruleset
from league.matchmaking.store import entries
from league.matchmaking.store.names import looks
from league.sim.config import CameraConfig, LidarConfig, SensorConfig
from tests.agents.trained import make_card, make_checkpoint
from tests.matchmaking import leagues
from tests.matchmaking.hostile_entries import (
    GIVEN,
    HEADER,
    HOSTILE,
    NUMBERS,
    SOUND,
    joined,
    with_card,
)
from tests.matchmaking.season_kit import SHORT, new_league

OLD = "ac7b2dcfed38aa0d0942855339df16b54227bacc6b3f39bd0473f47c47854cc9"
"""Id of a policy as the versions before `history` and `truth` had it."""


def test_what_is_packed_is_what_is_read():
    again = submission.unpack(SOUND)
    assert again.digest == GIVEN.digest and again.card == GIVEN.card
    assert all(np.array_equal(again.weights[name], GIVEN.weights[name]) for name in GIVEN.weights)


def test_the_safetensors_package_reads_the_same_numbers():
    theirs = safetensors_load(SOUND)
    assert theirs.keys() == GIVEN.weights.keys()
    assert all(np.array_equal(theirs[name], GIVEN.weights[name]) for name in theirs)


def test_packing_twice_gives_the_same_bytes_and_so_the_same_entry():
    assert submission.pack(make_checkpoint("lidar", network=NetworkConfig(hidden=(8,)))) == SOUND


def test_a_card_too_long_for_the_header_is_refused_when_it_is_packed():
    results = {f"figure {n} {'x' * 60}": float(n) for n in range(64)}
    parents = tuple(heat_spec.digest(bytes([n])) for n in range(64))
    tracks = tuple(f"{n} " + "é" * 76 for n in range(120))
    long = make_checkpoint("blind", results=results, parents=parents, tracks=tracks)
    with pytest.raises(PolicyError, match=r"header of .* bytes: shorten"):
        submission.pack(long)


@pytest.mark.parametrize("what", HOSTILE)
def test_hostile_submissions_are_refused_in_one_sentence(what, capsys):
    start = time.process_time()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(PolicyError) as refusal:
        submission.unpack(HOSTILE[what])
    assert "\n" not in str(refusal.value) and len(str(refusal.value)) < 700
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200 * 1024  # kB
    assert time.process_time() - start < 1.0
    assert "executed" not in capsys.readouterr().out


def test_the_hostile_corpus_would_be_accepted_without_its_poison():
    assert joined(HEADER, NUMBERS) != HOSTILE["a hole in the numbers"]
    assert submission.unpack(joined(HEADER, NUMBERS)).digest == GIVEN.digest
    assert submission.unpack(with_card(name="other")).card.name == "other"


def test_ten_thousand_mutated_submissions_are_refused_or_sound():
    dice = random.Random(7)
    refused = 0
    for _ in range(10_000):
        content = bytearray(SOUND)
        end = len(content) - len(NUMBERS) if dice.random() < 0.8 else len(content)
        for _ in range(dice.choice((1, 1, 2, 8))):
            content[dice.randrange(end)] = dice.randrange(256)
        if dice.random() < 0.1:
            del content[dice.randrange(len(content)) :]
        try:
            submission.unpack(bytes(content))
        except PolicyError:
            refused += 1
    assert 5_000 < refused < 10_000


def test_a_network_that_overflows_is_refused_by_the_probe():
    # Seven layers, each adding 65 or 512 inputs times 9e3: beyond 4e45, where float32 ends at 3e38.
    deep = make_checkpoint("lidar", network=NetworkConfig(hidden=(512,) * 6, activation="relu"))
    weights = {name: np.full_like(weight, 9e3) for name, weight in deep.weights.items()}
    with pytest.raises(PolicyError, match="NaN or infinity"):
        submission.probe(checkpoint.Checkpoint(deep.card, weights))


def test_a_sound_policy_passes_the_probe():
    assert 0 < submission.probe(GIVEN) <= submission.PROBE_S


CAMERA = CameraConfig(width=64, height=48)


@pytest.mark.parametrize(
    "sensors",
    [
        SensorConfig(camera=CameraConfig(width=64, height=48, up=0.25)),
        SensorConfig(camera=CameraConfig(width=64, height=48, rate_hz=10.0)),
        SensorConfig(camera=CameraConfig(width=64, height=48, field_of_view=2.0)),
        SensorConfig(camera=CameraConfig(width=320, height=240)),
        SensorConfig(lidar=LidarConfig(half_angle=3.1)),
        SensorConfig(lidar=LidarConfig(noise=0.0)),
        SensorConfig(camera=CAMERA, lidar=LidarConfig(rate_hz=15.0)),
    ],
)
def test_sensors_that_are_not_stock_are_refused_where_only_stock_may_race(sensors):
    with pytest.raises(PolicyError, match=r"stock sensors|smaller ones"):
        submission.check_sensors(sensors, Ruleset())
    submission.check_sensors(sensors, Ruleset(sensors="any"))


@pytest.mark.parametrize("senses", ["blind", "lidar", "stereo", "all"])
def test_stock_sensors_of_any_picture_size_may_race(senses):
    submission.check_sensors(make_card(senses).sensors, Ruleset())


def test_a_refused_submission_leaves_the_league_as_it_was(tmp_path):
    with new_league(f"sqlite:///{tmp_path / 'league.db'}") as store:
        before = store.entries(), len(leagues.events(store))
        for content in (HOSTILE["NaN"], HOSTILE["no card"], SOUND[:-4]):
            with pytest.raises(LeagueError):
                submission.accept(store, content, "evil", "mallory")
        assert (store.entries(), len(leagues.events(store))) == before
        assert not leagues.keeps(store, heat_spec.digest(HOSTILE["NaN"]))


def test_a_checkpoint_file_becomes_a_pending_entry_whose_blob_is_no_pickle(tmp_path):
    path = tmp_path / "a.pt"
    checkpoint.save(path, GIVEN)
    with new_league(f"sqlite:///{tmp_path / 'league.db'}") as store:
        entry = submission.submit(store, path, "ann's car", "ann")
        assert (entry.state, entry.owner) == ("pending", "ann")
        assert entry.id == submission.identity(GIVEN) and entry.blob == heat_spec.digest(SOUND)
        assert store.blobs.get(entry.blob) == SOUND
        assert entry.card["digest"] == GIVEN.digest
        assert submission.submit(store, path, "ann's car", "ann") == entry
        assert b"pickle" not in SOUND and np.frombuffer(SOUND[:8], "<u8")[0] < 65536
        assert SHORT.sensors == "stock"


def relaid(content: bytes) -> bytes:
    """Return the same entry with spaces at the end of its header."""
    (size,) = struct.unpack("<Q", content[:8])
    return struct.pack("<Q", size + 40) + content[8 : 8 + size] + b" " * 40 + content[8 + size :]


@pytest.mark.parametrize(
    "content",
    [with_card(name="other"), with_card(command="league train", steps=7), relaid(SOUND)],
    ids=["another name", "another history", "another layout"],
)
def test_the_same_policy_with_another_card_or_layout_is_the_same_entry(tmp_path, content):
    with new_league(f"sqlite:///{tmp_path / 'league.db'}") as store:
        entry = submission.accept(store, SOUND, "ann's car", "ann")
        assert content != SOUND
        assert submission.accept(store, content, "second car", "ann") == entry
        assert not leagues.keeps(store, heat_spec.digest(content))
        with pytest.raises(LeagueError, match="entered already, as \"ann's car\" by 'ann'"):
            submission.accept(store, content, "stolen", "bob")


def test_identity_depends_on_all_that_the_driving_depends_on():
    ids = {submission.identity(GIVEN)}
    for other in (
        make_checkpoint("lidar", network=NetworkConfig(hidden=(8,)), seed=1),
        make_checkpoint("lidar", network=NetworkConfig(hidden=(8,), activation="relu")),
        make_checkpoint("stereo", network=NetworkConfig(hidden=(8,))),
    ):
        ids.add(submission.identity(other))
    assert len(ids) == 4
    mounted = replace(GIVEN.card.sensors, lidar=LidarConfig(up=0.15))
    card = GIVEN.card.model_copy(update={"sensors": mounted})
    assert submission.identity(checkpoint.Checkpoint(card, GIVEN.weights)) not in ids


def test_a_policy_of_an_older_league_is_known_again(tmp_path):
    with new_league(f"sqlite:///{tmp_path / 'league.db'}") as store:
        store.submit("damaged", "ann", weights=b"rubbish")
        old = store.submit("old", "ann", weights=SOUND, card=json.loads(GIVEN.text))
        assert old.id == heat_spec.digest(SOUND)  # as all entries were named before
        assert submission.accept(store, with_card(name="new"), "new", "ann") == old
        with pytest.raises(LeagueError, match="entered already, as 'old'"):
            submission.accept(store, relaid(SOUND), "new", "bob")


@pytest.mark.parametrize(("noise", "near"), [(1e-3, "ann's car"), (0.1, "")])
def test_near_copies_are_labelled(tmp_path, noise, near):
    generator = np.random.default_rng(0)
    weights = {
        name: (weight * (1 + noise * generator.normal(size=weight.shape))).astype(np.float32)
        for name, weight in GIVEN.weights.items()
    }
    with new_league(f"sqlite:///{tmp_path / 'league.db'}") as store:
        submission.accept(store, SOUND, "ann's car", "ann")
        other = submission.pack(checkpoint.Checkpoint(GIVEN.card, weights))
        entry = submission.accept(store, other, "bob's car", "bob")
        assert entry.near_copy_of == store.entry("bob's car").near_copy_of == near


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("Racer", "looks like 'racer'"),
        ("ra\uff43er", "looks like 'racer'"),
        ("ra\u0441er", "mixes letters of CYRILLIC, LATIN"),
        ("r\u03b1cer", "mixes letters of GREEK, LATIN"),
        ("racer\u3164", "cannot be seen"),
        ("rac\ufe0fer", "cannot be seen"),
        ("rac\u200ber", "printable"),
        ("\u0441\u043e\u0440\u0435", "looks like 'cope'"),
    ],
)
def test_names_that_pass_for_others_are_refused(tmp_path, name, reason):
    with new_league(f"sqlite:///{tmp_path / 'league.db'}") as store:
        for known in ("racer", "cope"):
            store.submit(known, "ann", weights=known.encode())
        with pytest.raises(StoreError, match=reason):
            store.submit(name, "bob", weights=b"other")
        with pytest.raises(StoreError, match="the owner 'Ann' looks like 'ann'"):
            store.submit("new", "Ann", weights=b"other")
        for fine in (
            "\u0433\u043e\u043d\u0449\u0438\u043a",
            "\u8d64\u3044\u8eca GT",
            "Zo\u00eb 2",
            "racer 2",
        ):
            assert store.submit(fine, "bob", weights=fine.encode()).name == fine


@pytest.mark.parametrize(
    ("name", "known"),
    [
        ("dueIist", "duelist"), ("due1ist", "duelist"), ("due|ist", "duelist"),
        ("bIocker", "blocker"), ("bl0cker", "blocker"), ("g1obetrotter", "globetrotter"),
        ("d0dger", "dodger"), ("r\u0251cer", "racer"), ("\u0280acer", "racer"),
        ("nov\u00edce", "novice"), ("duelist.", "duelist"), ("racer\u00b2", "racer"),
        ("racer\u00b7", "racer"), ("-racer-", "racer"), ("ra cer", "racer"), ("ra.cer", "racer"),
        ("\u13a1\u13aa\u13df\u13ac\u13a1", "racer"), ("\u0142ion", "lion"), ("rnole", "mole"),
        ("car 10.", "car 10"), ("car IO", "car 10"), ("!!! ", "!!!"),
    ],
)  # fmt: skip
def test_names_that_a_reader_takes_for_another_look_like_it(name, known):
    assert looks(name.strip()) & looks(known)
    assert looks(known) & looks(known.upper())


def test_numbers_and_other_words_tell_names_apart(tmp_path):
    fine = (
        "car 1", "car 2", "car 10", "car 11", "v1", "v2", "v10", "v1.0", "v1.10", "v11.0",
        "\u043c\u043e\u0439", "\u30ab\u30fc", "\u30ac\u30fc", "!!!", "???", "C", "C++",
        "racer", "tracer",
    )  # fmt: skip
    with new_league(f"sqlite:///{tmp_path / 'league.db'}") as store:
        for name in fine:
            assert store.submit(name, "ann", weights=name.encode()).name == name
        with pytest.raises(StoreError, match="'c\\+\\+\\.' looks like 'C\\+\\+'"):
            store.submit("c++.", "bob", weights=b"other")
        with pytest.raises(StoreError, match="the owner 'ann_' looks like 'ann'"):
            store.submit("new", "ann_", weights=b"other")


def test_names_that_were_taken_before_they_looked_alike_stay(tmp_path, monkeypatch):
    with new_league(f"sqlite:///{tmp_path / 'league.db'}") as store:
        with monkeypatch.context() as older:
            older.setattr(entries, "looks", lambda name: frozenset({name}))
            for owner, name in (("ann", "racer"), ("Ann", "rac3r"), ("4nn", "Racer")):
                store.submit(name, owner, weights=name.encode())
        assert store.entry("Racer").owner == "4nn"
        assert store.submit("Racer", "4nn", weights=b"Racer").name == "Racer"  # again
        assert store.submit("new", "Ann", weights=b"new").owner == "Ann"


def test_settings_of_sensors_that_came_later_do_not_change_older_ids():
    card = Card(name="old", sensors=SensorConfig(camera=CameraConfig(width=64, height=48)))
    weights = {name: np.full(shape, 0.5, np.float32) for name, shape in card.weight_shapes.items()}
    assert submission.identity(Checkpoint(card, weights)) == OLD


def test_a_policy_that_is_given_the_true_state_is_refused():
    with pytest.raises(PolicyError, match="no car can measure"):
        submission.check_sensors(SensorConfig(truth=True), Ruleset(sensors="any"))


def test_weights_are_offered_for_download_only_if_their_owner_says_so(tmp_path):
    with new_league(f"sqlite:///{tmp_path / 'league.db'}", rules=SHORT) as store:
        assert not submission.accept(store, SOUND, "ann's car", "ann").downloadable
        other = submission.pack(make_checkpoint("lidar", network=NetworkConfig(hidden=(9,))))
        assert submission.accept(store, other, "bob's car", "bob", download=True).downloadable
        # The first submission decides.
        again = submission.accept(store, SOUND, "ann's car", "ann", download=True)
        assert not again.downloadable
        with pytest.raises(PolicyError):
            submission.accept(store, with_card(download=True), "eve's car", "eve")
