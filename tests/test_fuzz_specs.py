"""Race specs of unknown origin: each ends in a value, or in an error that a user can read."""

import math
import random

import pytest
from pydantic import ValidationError

from league.envs.config import EnvConfig
from league.errors import ConfigError, LeagueError
from league.race_spec import RaceSpec, checked
from league.racing import race
from league.sim.config import SimConfig
from tests.scenes import make_ring

JUNK = (
    None, True, False, 0, 1, -1, 2, 8, 9, 2**31, 2**63, -(2**63), 10**400, 0.0, -0.0, 0.5, 1e308,
    math.nan, math.inf, -math.inf, "", " ", "0", "1e9", "null", "\x00", "é" * 50, "x" * 10_000,
    "../../etc/passwd", "reinvent_2018", "ring", b"bytes", (), [], {}, set(), [[]], [None] * 9,
    {"name": "a"}, [{"name": "a"}] * 2, [{"name": ""}], [{"name": "a", "digest": "f" * 65}],
    [{"nome": "a"}], object(), len, 3 + 4j,
)  # fmt: skip
PLAUSIBLE = {
    "track": ("ring", "reinvent_2018", "peanut"),
    "kind": ("time_trial", "obstacle_avoidance", "head_to_head"),
    "laps": (1, 3, 1000, 1.0, "2"),
    "seed": (0, 1, 2**63 - 1),
    "solver": ("planar", "bullet"),
    "ranking": ("total", "best", "average"),
    "entries": tuple([{"name": "centerline"}] * count for count in (1, 1, 2, 3, 8)),
    "obstacles": (0, 1, 6, 32),
    "obstacle_kind": ("box", "bot"),
    "random_obstacles": (True, False),
    "off_track_penalty_s": (0, 0.01, 2.0, 600.0),
    "crash_penalty_s": (0.0, 5, 600),
    "max_time_s": (0.0, 0.05, 1, 36_000),
}
STRANGE = ("Track", "laps ", "__class__", "", "entries.0")


def settings_of(dice: random.Random) -> dict:
    """Return settings most of which are plausible, some junk, some missing, some unheard of."""
    spoilt = dice.choice((0.0, 0.0, 0.1, 0.5, 1.0))
    wanted = {"entries": PLAUSIBLE["entries"][0]}
    for name in dice.sample(list(PLAUSIBLE), dice.randint(0, len(PLAUSIBLE))):
        wanted[name] = dice.choice(JUNK if dice.random() < spoilt else PLAUSIBLE[name])
    if dice.random() < 0.3 * spoilt:
        wanted[dice.choice(STRANGE)] = dice.choice(JUNK)
    return wanted


def one_sentence(error: LeagueError) -> bool:
    said = str(error)
    return 10 < len(said) < 500 and "\n" not in said


@pytest.mark.parametrize("seed", range(6))
def test_thousand_random_specs_each_end_in_a_value_or_a_readable_error(seed):
    dice = random.Random(seed)
    accepted = refused = 0
    for _ in range(1000):
        settings = settings_of(dice)
        try:
            spec = RaceSpec(**settings)
        except ValidationError:
            with pytest.raises(ConfigError) as refusal:
                checked(settings)
            assert one_sentence(refusal.value), refusal.value
            refused += 1
            continue
        assert checked(settings) == spec
        assert RaceSpec.model_validate_json(spec.model_dump_json()) == spec
        try:
            sim = race.sim_config(spec)
            EnvConfig(sim=sim, solver=spec.solver)
        except LeagueError as error:
            assert one_sentence(error)
            refused += 1
            continue
        assert isinstance(sim, SimConfig)
        accepted += 1
    # Neither is so rare that the other is all that was tried.
    assert accepted > 100
    assert refused > 100


@pytest.mark.parametrize(
    "settings", [{}, {"entries": []}, {"entries": JUNK[-1]}, {1: 2}, {"a": "b"}]
)
def test_settings_without_a_field_of_drivers_are_refused(settings):
    with pytest.raises(ConfigError) as refusal:
        checked(settings)
    assert one_sentence(refusal.value)


@pytest.mark.parametrize("seed", range(150))
def test_random_specs_that_are_accepted_can_be_raced(seed):
    dice = random.Random(1000 + seed)
    longest = 1.0 if seed % 12 == 0 else 0.1
    while True:
        settings = settings_of(dice) | {"max_time_s": dice.choice((0.05, 0.5 * longest, longest))}
        try:
            spec = checked(settings)
            race.sim_config(spec)
            break
        except LeagueError:
            continue
    try:
        result = race.run(spec, track=make_ring(), record=False).result
    except LeagueError as error:
        assert one_sentence(error)
        return
    assert result.steps == math.ceil(spec.max_time_s * 15 - 1e-6)
    assert [car.place for car in result.order] == list(range(1, len(spec.entries) + 1))
    assert RaceSpec.model_validate(result.spec.model_dump()) == spec
