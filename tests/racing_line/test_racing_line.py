"""The fastest line: a ring by hand, shipped tracks by what must hold on any."""

import hashlib
import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.lap_optimum import lap_optimum, strays
from league.racing_line.racing_line import center_line, lap_bound, optimal_line
from league.racing_line.search import CarLimits
from league.sim.config import CarConfig
from league.track import files
from league.track.track import Track, TrackSet


def ring(radius: float, width: float = 0.8) -> Track:
    """A circle driven counter-clockwise."""
    count = round(2 * math.pi * radius / 0.05)
    angle = np.arange(count) * (2 * math.pi / count)
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return Track(
        name="ring",
        title="Ring",
        center=radius * unit,
        left=(radius - width / 2) * unit,
        right=(radius + width / 2) * unit,
    )


def digest(*arrays: np.ndarray) -> str:
    return hashlib.sha256(b"".join(one.tobytes() for one in arrays)).hexdigest()[:16]


def test_the_fastest_line_of_a_narrow_ring_hugs_the_inside():
    # Time is 2 pi r / sqrt(g r): the smallest radius wins.
    car = CarConfig()
    line = optimal_line(ring(1.5), car, margin=0.1)
    radius = 1.5 - 0.3
    grip = CarLimits.of(car).lateral
    assert line.lateral == pytest.approx(np.full(len(line.s), 0.3), abs=0.01)
    assert line.lap_time == pytest.approx(2 * math.pi * math.sqrt(radius / grip), rel=0.005)


def test_the_bound_of_a_ring_uses_the_road_until_the_last_wheel_leaves_it():
    # The inner wheels may be off: the base goes half of the wheel track beyond the border.
    car = CarConfig()
    radius = 1.5 - 0.4 - car.wheel_track / 2
    expected = 2 * math.pi * math.sqrt(radius / (car.grip * 9.81))
    assert lap_bound(ring(1.5), car) == pytest.approx(expected, rel=0.005)


def test_the_best_lap_of_a_ring_is_driven_at_the_limit_and_the_simulator_drives_it_too():
    pytest.importorskip("casadi", reason="the extra `optimum` is not installed")
    track, car = ring(1.5), CarConfig()
    lap = lap_optimum(track, car)
    radius = 1.5 - 0.4 - car.wheel_track / 2
    least = 2 * math.pi * math.sqrt(radius / (car.grip * 9.81))
    # Turned front wheels push back a little, and what drives against that is lost to cornering.
    assert least < lap.time < 1.03 * least
    place, speed = strays(lap, car)
    assert place < 0.002
    assert speed < 0.05


def test_a_line_keeps_its_margin_and_follows_its_own_geometry():
    track = files.load("reinvent_2018")
    line = optimal_line(track, CarConfig(), margin=0.05)
    half = 0.762 / 2 - 0.05
    assert np.abs(line.lateral).max() < half + 0.01
    # Turning along a loop adds up to one turn: curvature times distance is 2 pi.
    step = track.length / len(line.s)
    assert np.sum(line.curvature * line.stretch * step) == pytest.approx(2 * math.pi, rel=0.01)


def test_more_grip_and_more_road_are_never_slower():
    track, car = files.load("peanut"), CarConfig()
    usual = optimal_line(track, car, margin=0.05).lap_time
    assert optimal_line(track, replace(car, grip=0.9), margin=0.05).lap_time < usual
    assert optimal_line(track, car, margin=0.0).lap_time < usual
    assert usual < center_line(track, car, share=1.0, top_speed=4.0).lap_time


def test_a_track_and_its_line_have_the_same_bits_on_every_machine():
    # Another digest than these: races on this machine would differ from those elsewhere.
    track = files.load("harbour_oval")
    assert digest(TrackSet(track).points) == "5898bb01e8662c33"
    for _ in range(2):
        line = optimal_line(track, CarConfig(), 0.0)
        assert digest(line.lateral, line.heading, line.curvature, line.speed) == "461f5a1831d5f8b8"


def test_the_centreline_stays_on_the_centreline():
    track = files.load("reinvent_2018")
    line = center_line(track, CarConfig(), share=0.35, top_speed=2.0)
    assert np.abs(line.lateral).max() < 0.01
    assert line.speed.max() <= 2.0


def test_an_open_track_is_driven_from_end_to_end_within_its_borders():
    angle = np.linspace(0, math.pi / 2, 32)  # a quarter of a circle to the left, radius 1
    unit = np.stack([np.sin(angle), 1 - np.cos(angle)], axis=1)
    normal = np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    center = 1.0 * unit
    track = Track(
        "bend", "Bend", center, center + 0.4 * normal, center - 0.4 * normal, closed=False
    )
    car = CarConfig()
    line = optimal_line(track, car, margin=0.1)
    assert line.s[0] == 0.0 and line.s[-1] == pytest.approx(track.length)
    assert np.abs(line.lateral).max() < 0.3 + 0.005
    # It cuts the bend on the way from the middle to the inside and back, nearly at 4 m/s.
    assert line.lateral[0] < 0.2 and line.lateral[-1] < 0.2 and line.lateral.max() > 0.28
    assert line.speed.min() > 3.9
    assert line.lap_time < center_line(track, car, share=1.0, top_speed=4.0).lap_time


@pytest.mark.parametrize("rate", [1.0, 2.0, 4.0])
def test_the_curvature_of_a_line_changes_no_faster_than_was_asked(rate):
    line = optimal_line(files.load("reinvent_2018"), CarConfig(), 0.05, curvature_rate=rate)
    step = line.stretch * (line.s[1] - line.s[0])
    turns = np.abs(np.diff(line.curvature)) / step[:-1]
    # Inside of bends points are closer. Without a limit it changes by up to 8 in a metre.
    assert 0.8 * rate < turns.max() < 1.25 * rate


def test_a_line_bends_no_tighter_than_the_car_can():
    car = CarConfig(max_steering=0.25)  # 1.56 1/m; without a limit the line has 2.65
    line = optimal_line(files.load("switchback"), car, margin=0.0)
    assert np.abs(line.curvature).max() < 1.03 * math.tan(0.25) / car.wheelbase


def test_a_mirrored_track_has_the_mirrored_line():
    track, car = files.load("harbour_oval"), CarConfig()
    line, other = (optimal_line(one, car, 0.05) for one in (track, track.mirrored()))
    np.testing.assert_allclose(other.lateral, -line.lateral, atol=1e-3)
    assert other.lap_time == pytest.approx(line.lap_time, rel=1e-4)


def test_a_line_that_was_worse_before_the_search_was_compiled_would_be_noticed():
    # What sequential linear programming had found on the same tracks, for the same car.
    found = {"reinvent_2018": 4.6649, "switchback": 13.4669, "needle_pass": 8.1380, "anvil": 9.4591}
    for name, time in found.items():
        line = optimal_line(files.load(name), CarConfig(), 0.0, share=0.95)
        assert line.lap_time < 1.005 * time
