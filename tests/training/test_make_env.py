"""The tracks of a run: names, files, random ones, both directions."""

import pytest

from league.errors import ConfigError, TrackError
from league.track import files
from league.training.ppo import make_env
from tests.scenes import make_ring


def test_names_and_files_are_loaded_in_order(tmp_path):
    files.save(files.load("peanut"), tmp_path / "mine.yaml")
    found = make_env.load_tracks(["reinvent_2018", str(tmp_path / "mine.yaml")])
    assert [track.name for track in found] == ["reinvent_2018", "peanut"]


def test_random_tracks_are_as_many_as_asked_and_the_same_each_time():
    first, again = make_env.load_tracks(["generated:3"]), make_env.load_tracks(["generated:3"])
    assert len(first) == 3
    assert [files.dump(one) for one in first] == [files.dump(one) for one in again]
    assert len({files.dump(one) for one in first}) == 3


def test_more_random_tracks_contain_the_fewer():
    assert files.dump(make_env.load_tracks(["generated:2"])[1]) == files.dump(
        make_env.load_tracks(["generated:3"])[1]
    )


@pytest.mark.parametrize(
    "name",
    ["generated:", "generated:0", "generated:-1", "generated:2001", "generated:x", "generated:1.5"],
)
def test_wrong_number_of_random_tracks_gets_one_sentence(name):
    with pytest.raises(ConfigError, match="give generated:1 to generated:2000"):
        make_env.load_tracks([name])


def test_no_track_and_unknown_track_are_refused():
    with pytest.raises(ConfigError, match="no track was named: give --track NAME"):
        make_env.load_tracks([])
    with pytest.raises(TrackError, match="there is no track 'peanutt'; nearest: peanut"):
        make_env.load_tracks(["peanutt"])


def test_named_tracks_are_judged_on_themselves():
    assert [t.name for t in make_env.tracks_for_evaluation(["peanut", "generated:9"])] == ["peanut"]
    many = files.names()
    assert [t.name for t in make_env.tracks_for_evaluation(many)] == many[: make_env.MAX_EVALUATED]


def test_random_tracks_are_judged_on_others_that_are_never_trained_on(monkeypatch):
    drawn = []
    ring = make_ring()
    monkeypatch.setattr(make_env, "generate", lambda seed, **settings: drawn.append(seed) or ring)
    make_env.load_tracks([f"generated:{make_env.MAX_GENERATED}"])
    trained = set(drawn)
    drawn.clear()
    judged = make_env.tracks_for_evaluation(["generated:5"])
    assert trained == set(range(make_env.MAX_GENERATED))
    assert len(judged) == len(set(drawn)) >= 4
    assert trained.isdisjoint(drawn)


def test_both_directions_are_each_track_and_the_same_the_other_way_round():
    ways = make_env.track_set(
        make_env.load_tracks(["reinvent_2018", "peanut"]), both_directions=True
    )
    assert [track.name for track in ways.tracks] == [
        "reinvent_2018",
        "reinvent_2018_reversed",
        "peanut",
        "peanut_reversed",
    ]
    assert ways.courses["inner"][0] == -ways.courses["inner"][1]
    assert ways.length[0] == pytest.approx(ways.length[1])
    one = make_env.track_set(make_env.load_tracks(["peanut"]), both_directions=False)
    assert len(one.tracks) == 1
