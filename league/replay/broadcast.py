"""A race as it is broadcast: its story in sentences, and which cars the camera follows.

The story tells of attacks, passes, contacts, gaps at the line and the winner; the director follows
the closest fight, cuts when it is decided, and at the end shows the winner cross the line.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from league import times
from league.race_spec import Event, RaceResult, RaceSpec
from league.replay.replay import Replay
from league.sim.config import CarConfig
from league.track.track import Track

Cars = Mapping[str, np.ndarray] | np.ndarray
"""One moment's cars: records, or columns by name, (num_cars,) each; FIELDS are read."""
_MOTION = ("x", "y", "velocity_x", "velocity_y", "distance")
FIELDS = (*_MOTION, "laps", "ghost")

ATTACK = 0.7  # an attacker is at most this far behind along the track, between the bases [m]
APART = 1.5  # from here on a fight is over [m]
LEVEL = 0.75 * CarConfig().length
"""Two cars closer than this overlap by a quarter of their length: side by side [m]."""
CLOSING = 0.1  # an attacker comes closer at least this fast [m/s]
QUIET_S = 5.0  # the same pair is not mentioned as attacking or level again for so long [s]
AFTER_START_S = 1.5  # on the grid all cars are close to each other [s]
BACK_S = 10.0  # a pass so soon after being passed takes the place back [s]
PACK = 3.0  # two cars this close along the track [m] are in one picture
SHORTEST_S = 2.5  # no shot is shorter, but for one that the winner's finish ends [s]
HOLD_S = 1.5  # a fight that is decided is still shown for so long [s]
FINISH = 5.0  # from here on the winner is shown until it has crossed the line [m]
CLOSER = 0.5  # another fight is worth a cut if its gap is at most this share of the present one's
SMOOTHING_S = 0.45  # how slowly the chase camera turns; it moves three times as fast [s]

_WEIGHT = {
    "winner": 0, "closest_fight": 0, "overtake": 1, "forced_off": 1, "crash": 2, "lead_change": 2,
    "defended": 3, "gap": 4, "off_track": 5, "obstacle_contact": 5, "touch": 6, "side_by_side": 7,
    "attack": 8,
}  # fmt: skip
"""What a short story keeps first; what is not named here it leaves out."""


@dataclass(frozen=True)
class Remark:
    """One sentence of the story."""

    time_s: float  # race time [s]
    kind: str  # an event's kind, or attack, side_by_side, defended, gap, winner, closest_fight
    car: int  # grid slot of the car it is about
    lap: int  # lap that this car was on, from 1
    text: str  # the sentence, without lap and time

    @property
    def stamped(self) -> str:
        """Lap, time and sentence."""
        return f"lap {self.lap}, {times.clock(self.time_s)[:-2]}: {self.text}"


@dataclass
class _Fight:
    """What two cars have between them."""

    near_s: float = 0.0  # how long they have been close, in the whole race [s]
    attacker: int | None = None  # who attacks and has neither passed nor fallen back
    # when each kind of line was last said [s]
    said_s: dict[str, float] = field(default_factory=dict)
    passed: tuple[int, float] = (-1, -np.inf)  # who passed last, and when [s]


class Commentator:
    """Follows one race step by step; what it says depends on nothing later."""

    def __init__(
        self, spec: RaceSpec, names: Sequence[str], *, closed: bool = True, pursuit_m: float = 0.0
    ) -> None:
        """Begin before the start; `names` are the drivers', by grid slot.

        On a track that is not closed a race is one lap. `pursuit_m` is what `lap_of_pursuit`
        returns.
        """
        self._spec, self._names, self._pursuit_m = spec, names, pursuit_m
        self._laps = spec.laps_on(closed=closed)
        self._before: tuple[float, dict[str, np.ndarray]] | None = None  # time, columns of cars
        self._fights: dict[frozenset[int], _Fight] = {}
        self._lap_times_s: list[list[float]] = [[] for _ in names]
        self._crossings: dict[int, list[tuple[float, int]]] = {}
        self._won = False

    def add(self, time_s: float, cars: Cars, events: Iterable[Event] = ()) -> list[Remark]:
        """Return what is to be said about one step, which ended at `time_s`."""
        events = tuple(events)
        laps = np.asarray(cars["laps"])
        # Fights first: cars are side by side before one passes the other in the same step.
        lines = [
            Remark(time_s, kind, car, 1 + int(laps[car]), text)
            for kind, car, text in self._about_fights(time_s, cars)
        ]
        lines += [
            Remark(event.time_s, kind, car, 1 + int(laps[car]) - (event.kind == "lap"), text)
            for event in events
            for kind, car, text in self._about(event, events, cars)
        ]
        self._before = time_s, {name: np.array(cars[name], np.float64) for name in _MOTION}
        return self._on_laps(lines)

    def end(self, result: RaceResult) -> list[Remark]:
        """Return what is said when the race is over."""
        lines, first = [], result.order[0]
        if not self._won and len(result.order) > 1:
            lines.append(Remark(result.race_s, "winner", first.car, first.laps, _won(result)))
        fights = [(fight.near_s, pair) for pair, fight in self._fights.items() if fight.near_s]
        if fights:
            near_s, pair = max(fights, key=lambda one: (one[0], -min(one[1])))
            one, other = sorted(pair)
            text = (
                f"closest fight: {self._names[one]} and {self._names[other]}, within {ATTACK} m "
                f"for {near_s:.1f} s"
            )
            lines.append(Remark(result.race_s, "closest_fight", one, first.laps, text))
        return self._on_laps(lines)

    def _on_laps(self, lines: list[Remark]) -> list[Remark]:
        """Return lines of the cooling lap, or of before the start, with a lap of the race."""
        return [replace(line, lap=min(max(line.lap, 1), self._laps)) for line in lines]

    def _about_fights(self, time_s: float, cars: Cars) -> Iterable[tuple[str, int, str]]:
        """Yield kind, car and text of what happens between neighbours."""
        if self._before is None or time_s < AFTER_START_S:
            return
        step_s, gaps = time_s - self._before[0], gaps_m(cars, self._pursuit_m)
        places_before = places_m(self._before[1], self._pursuit_m)
        near = set(map(frozenset, gaps))
        for pair, fight in self._fights.items():
            if pair not in near:
                fight.attacker = None
        for (front, rear), gap in gaps.items():
            before = float(places_before[front] - places_before[rear])
            fight = self._fights.setdefault(frozenset((front, rear)), _Fight())
            if gap > APART:
                if fight.attacker == rear:
                    yield "defended", front, f"{self._of(front)} defends against {self._of(rear)}"
                fight.attacker = None
            if gap >= ATTACK:
                continue
            fight.near_s += step_s
            closing = (before - gap) / step_s
            if gap >= LEVEL and closing > CLOSING and fight.attacker is None:
                fight.attacker = rear
                if _is_news(fight, "attack", time_s):
                    behind_s = _seconds(gap, cars, rear)
                    text = f"{self._of(rear)} attacks {self._of(front)}, {behind_s:.2f} s behind"
                    yield "attack", rear, text
            if gap < LEVEL and _is_news(fight, "side_by_side", time_s):
                first, second = sorted((front, rear))
                text = f"{self._of(first)} and {self._of(second)} side by side"
                yield "side_by_side", rear, text

    def _about(
        self, event: Event, events: Sequence[Event], cars: Cars
    ) -> Iterable[tuple[str, int, str]]:
        """Yield kind, car and text of what an event of the log says."""
        if event.kind in ("contact", "lead_change") and _is_said(event, events):
            return
        if event.kind == "overtake" and event.other is not None:
            yield "overtake", event.car, self._passes(event, event.other, cars)
            return
        yield event.kind, event.car, self._sentence(event)
        if event.kind == "lap" and event.value is not None:
            yield from self._gap_at_line(event.car, event.value)

    def _passes(self, event: Event, other: int, cars: Cars) -> str:
        fight = self._fights.setdefault(frozenset((event.car, other)), _Fight())
        last, passed_s = fight.passed
        back = last == other and event.time_s - passed_s < BACK_S
        fight.passed, fight.attacker = (event.car, event.time_s), None
        passes = f"{self._of(event.car)} passes {self._of(other)}{' back' * back}"
        if self._pursuit_m:
            return passes  # On the road: the places go by the distance driven.
        place = 1 + int((np.asarray(cars["distance"]) > cars["distance"][event.car]).sum())
        prize = "the lead" if place == 1 else f"place {place}"
        return f"{passes} for {prize}"

    def _gap_at_line(self, car: int, lap_s: float) -> Iterable[tuple[str, int, str]]:
        """Yield the gap of the first two at the end of a lap, and the winner's at the last."""
        driven = self._lap_times_s[car]
        driven.append(lap_s)
        lap = len(driven)
        crossed = self._crossings.setdefault(lap, [])
        crossed.append((sum(driven), car))
        if len(crossed) != 2:
            return
        # Of two in one step, the one with the larger slot may have been first.
        (first_s, first), (second_s, second) = sorted(crossed)
        margin = f"{second_s - first_s:.2f} s"
        if lap < self._laps:
            text = f"{self._of(first)} leads {self._of(second)} by {margin} at the line"
            yield "gap", first, text
        elif self._spec.ranking == "total":
            self._won = True
            yield "winner", first, f"{self._of(first)} wins, {margin} before {self._of(second)}"

    def _of(self, car: int | None) -> str:
        if car is None or not 0 <= car < len(self._names):
            return "another car"
        return self._names[car]

    def _sentence(self, event: Event) -> str:
        name, other, value = self._of(event.car), self._of(event.other), event.value
        penalty = f", {value:.1f} s penalty" if value else ""
        sentences = {
            "start": "The race is on",
            "lap": f"{name} completes a lap" + (f" in {value:.2f} s" if value else ""),
            "finish": f"{name} finishes" + (f" after {value:.2f} s" if value else ""),
            "off_track": f"{name} leaves the track{penalty}",
            "crash": f"{name} runs into {other}{self._impact(event)}{penalty}",
            "touch": f"{name} touches {other} lightly" + (f" at {value:.1f} m/s" if value else ""),
            "forced_off": f"{name} pushes {other} off the road{penalty}",
            "contact": f"{name} is hit" + (f" by {other}" if event.other is not None else ""),
            "obstacle_contact": f"{name} hits an obstacle{penalty}",
            "wall_contact": f"{name} hits the wall{penalty}",
            "immobilised": f"{name} is stuck{penalty}",
            "reversed": f"{name} drives backwards{penalty}",
            "put_back": f"{name} is back on the track",
            "lead_change": f"{name} takes the lead",
            "driver_fault": f"{name} gives no valid action",
        }
        return sentences.get(event.kind, event.kind)

    def _impact(self, event: Event) -> str:
        """Return how fast two cars came together, by their motion one step before a contact."""
        other = event.other
        if self._before is None or other is None or not 0 <= other < len(self._names):
            return ""
        x, y, velocity_x, velocity_y, _ = (
            column[other] - column[event.car] for column in self._before[1].values()
        )
        closing = -(velocity_x * x + velocity_y * y) / max(np.hypot(x, y), 1e-6)
        return f" at {closing:.1f} m/s" if closing >= 0.05 else ""


def lap_of_pursuit(spec: RaceSpec, track: Track) -> float:
    """Return the length of a lap [m] if a race is a pursuit, else 0."""
    return track.length if spec.format == "pursuit" else 0.0


def length_of_race(spec: RaceSpec, track: Track) -> float:
    """Return after how many metres a car has won; infinite where lap times decide."""
    length = spec.laps_on(closed=track.closed) * track.length
    return length if spec.ranking == "total" else np.inf


def places_m(cars: Cars, pursuit_m: float) -> np.ndarray:
    """Return how far ahead each car is, (num_cars,) [m]: cars that fight have near places.

    That is the distance driven. In a pursuit, with a lap of `pursuit_m`, cars that have driven as
    far may be half a lap of road apart; there it is the place on the road, counted from the largest
    empty stretch.
    """
    distance = np.asarray(cars["distance"], np.float64)
    if not pursuit_m:
        return distance
    on_road = (distance - np.arange(len(distance)) * pursuit_m / len(distance)) % pursuit_m
    ordered = np.sort(on_road)
    free = np.diff(ordered, prepend=ordered[-1] - pursuit_m)  # before each of them
    return (on_road - ordered[free.argmax()]) % pursuit_m


def gaps_m(cars: Cars, pursuit_m: float) -> dict[tuple[int, int], float]:
    """Return the gaps of neighbours by `places_m` that race, by (front, rear) [m]."""
    place, ghost = places_m(cars, pursuit_m), np.asarray(cars["ghost"]).astype(bool)
    order = [car for car in np.argsort(-place, kind="stable").tolist() if not ghost[car]]
    return {(one, other): float(place[one] - place[other]) for one, other in pairwise(order)}


def _seconds(gap: float, cars: Cars, rear: int) -> float:
    """Return the time that the rear car needs for a gap [m] at its speed [s]."""
    speed = float(np.hypot(cars["velocity_x"][rear], cars["velocity_y"][rear]))
    return gap / max(speed, 0.5)


def shortened(lines: Sequence[Remark], most: int) -> list[Remark]:
    """Return the lines that matter most, in order of time; of equal ones the later."""
    kept = [line for line in lines if line.kind in _WEIGHT]
    kept.sort(key=lambda line: (_WEIGHT[line.kind], -line.time_s))
    return sorted(kept[:most], key=lambda line: line.time_s)


def _is_news(fight: _Fight, kind: str, time_s: float) -> bool:
    """Return whether a line of this kind may be said now, and note that it is."""
    news = time_s - fight.said_s.get(kind, -np.inf) >= QUIET_S
    fight.said_s[kind] = time_s  # while it goes on, it stays old
    return news


def _is_said(event: Event, events: Sequence[Event]) -> bool:
    """Return whether another event of the step says it: a crash names the car it hit."""
    if event.kind == "contact":
        return any(one.kind in ("crash", "touch") and one.other == event.car for one in events)
    return any(one.kind == "overtake" and one.car == event.car for one in events)


def _won(result: RaceResult) -> str:
    first, second = result.order[:2]
    if not first.finished:
        laps = times.counted(first.laps, "lap")
        return f"{first.name} comes first with {laps} and {first.distance:.1f} m"
    if result.spec.ranking == "total":
        return f"{first.name} wins, the only one to finish"
    return f"{first.name} wins by its {result.spec.ranking} lap time, before {second.name}"


def moments(replay: Replay) -> Iterator[tuple[float, Cars]]:
    """Yield the time [s] of each frame and its cars."""
    columns = {name: getattr(replay.columns, name) for name in FIELDS}
    for frame, time_s in enumerate(replay.times_s.tolist()):
        yield time_s, {name: column[frame] for name, column in columns.items()}


def of_replay(replay: Replay, *, over: bool = True) -> list[Remark]:
    """Return the story of a recorded race, in order of time; its end only if it is `over`."""
    events: dict[int, list[Event]] = {}
    for event in replay.result.events:
        events.setdefault(round(event.time_s * replay.step_hz), []).append(event)
    track = replay.track
    lap_m = lap_of_pursuit(replay.spec, track)
    commentator = Commentator(replay.spec, replay.names, closed=track.closed, pursuit_m=lap_m)
    lines: list[Remark] = []
    for frame, (time_s, cars) in enumerate(moments(replay)):
        lines += commentator.add(time_s, cars, events.get(frame, ()))
    return lines + commentator.end(replay.result) if over else lines


# The camera ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Shot:
    """What a camera shows."""

    front: int  # the car in front of a fight, or a car alone
    rear: int  # the car behind, from behind which both are seen; `front` if it is alone
    since_s: float  # when the shot began [s]


class Director:
    """Chooses what to show step by step; the same for a film and a live view."""

    def __init__(self, pursuit_m: float = 0.0, race_m: float = np.inf) -> None:
        """Begin before the start, with what `lap_of_pursuit` and `length_of_race` return."""
        self._pursuit_m, self._race_m = pursuit_m, race_m
        self.shot: Shot | None = None  # what is shown; None before the first step
        self._open_s = 0.0  # when the fight of this shot was last undecided

    def gap_m(self, cars: Cars) -> float:
        """Return how far the two cars that are shown are apart along the road [m]."""
        assert self.shot is not None, "add a step first"
        place = places_m(cars, self._pursuit_m)
        return float(abs(place[self.shot.front] - place[self.shot.rear]))

    def sentence(self, names: tuple[str, ...], cars: Cars) -> str:
        """Return who attacks and the gap in seconds; empty if no car is near or one is a ghost."""
        shot, gap = self.shot, self.gap_m(cars)
        assert shot is not None
        ghost = cars["ghost"][shot.front] or cars["ghost"][shot.rear]
        if shot.front == shot.rear or gap > APART or ghost:
            return ""
        front, rear = names[shot.front], names[shot.rear]
        if gap < LEVEL:
            return f"{rear} and {front} side by side"
        does = "attacks" if gap < ATTACK else "chases"
        return f"{rear} {does} {front}, {_seconds(gap, cars, shot.rear):.1f} s"

    def add(self, time_s: float, cars: Cars) -> Shot:
        """Return what to show at a step that follows the one before."""
        gaps = gaps_m(cars, self._pursuit_m)
        if self.shot is None:
            self.shot = _best(gaps, cars, time_s)
            return self.shot
        shot = self.shot
        gap = gaps.get((shot.front, shot.rear))
        if gap is None and (shot.rear, shot.front) in gaps:
            gap = gaps[shot.rear, shot.front]
            # Side by side the order flickers: a pass is one when it is clear.
            if gap > LEVEL:
                shot = replace(shot, front=shot.rear, rear=shot.front)
        if gap is not None and gap <= PACK:
            self._open_s = time_s
        if np.asarray(cars["ghost"]).all():
            return shot
        first = int(np.argmax(cars["distance"]))
        if 0.0 < self._race_m - cars["distance"][first] <= FINISH and not cars["ghost"][first]:
            if first not in (shot.front, shot.rear):
                near = [pair for pair, gap in gaps.items() if pair[0] == first and gap <= PACK]
                shot = Shot(*(near[0] if near else (first, first)), time_s)
            self.shot, self._open_s = shot, time_s
            return shot
        best = _best(gaps, cars, time_s)
        decided = time_s - self._open_s >= HOLD_S
        other = {best.front, best.rear} != {shot.front, shot.rear}
        other = other and not _is_level(best, shot, cars)
        # The camera does not leave an attack, and what happened at its end is still shown.
        dull = gap is not None and ATTACK < gap <= PACK
        closer = dull and gaps.get((best.front, best.rear), np.inf) <= CLOSER * (gap or 0.0)
        if other and time_s - shot.since_s >= SHORTEST_S and (decided or closer):
            shot, self._open_s = best, time_s
        self.shot = shot
        return shot


def _best(gaps: dict[tuple[int, int], float], cars: Cars, time_s: float) -> Shot:
    """Return the closest fight, or the first car that still races."""
    if gaps:
        (front, rear), gap = min(gaps.items(), key=lambda item: item[1])
        if gap <= PACK:
            return Shot(front, rear, time_s)
    ghost = np.asarray(cars["ghost"]).astype(bool)
    distance = np.where(ghost & ~ghost.all(), -np.inf, cars["distance"])
    leader = int(distance.argmax())
    return Shot(leader, leader, time_s)


def _is_level(best: Shot, shot: Shot, cars: Cars) -> bool:
    """Return whether a car alone has hardly driven farther than one that is shown and races.

    In a pursuit the lead may go to and fro between cars that are half a lap of road apart.
    """
    racing = not (cars["ghost"][shot.front] or cars["ghost"][shot.rear])
    lead = float(cars["distance"][best.front] - cars["distance"][shot.rear])
    return best.front == best.rear and racing and lead < APART


@dataclass(frozen=True)
class ChasePath:
    """Where a chase camera's frame stands in each frame of a replay, (num_frames,)."""

    x: np.ndarray  # [m]
    y: np.ndarray  # [m]
    yaw: np.ndarray  # unwrapped within a take [rad]
    take: np.ndarray  # number of the take: between two of them the picture cuts, int64
    fights: tuple[str, ...]  # who attacks, which car and the gap; empty where there is no fight

    def at(self, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x, y and yaw between frames; no camera travels from one take to the next."""
        low = np.clip(np.floor(frames).astype(np.int64), 0, len(self.x) - 1)
        high = np.minimum(low + 1, len(self.x) - 1)
        part = np.where(self.take[low] == self.take[high], frames - low, 0.0)
        x, y, yaw = (
            column[low] + (column[high] - column[low]) * part
            for column in (self.x, self.y, self.yaw)
        )
        return x, y, yaw


def chase_path(replay: Replay) -> ChasePath:
    """Return where to chase from: behind the rear car of the fight that is shown.

    Where two are side by side, from farther behind the middle between them: neither is cut off.
    """
    from scipy.ndimage import gaussian_filter1d  # late: SciPy takes a while

    spec, track, columns = replay.spec, replay.track, replay.columns
    director = Director(lap_of_pursuit(spec, track), length_of_race(spec, track))
    subject, rival = (np.empty(replay.num_frames, np.int64) for _ in range(2))
    gap = np.empty(replay.num_frames)  # between these two [m]
    take, fights = np.zeros(replay.num_frames, np.int64), []
    for frame, (time_s, cars) in enumerate(moments(replay)):
        before, shot = director.shot, director.add(time_s, cars)
        subject[frame], rival[frame] = shot.rear, shot.front
        fights.append(director.sentence(replay.names, cars))
        gap[frame] = director.gap_m(cars)
        cut = before is not None and before.since_s != shot.since_s > 0.0
        # A short way is gone rather than cut: a jump by a car's length looks like a fault.
        old = subject[max(frame - 1, 0)]
        way = cars["x"][shot.rear] - cars["x"][old], cars["y"][shot.rear] - cars["y"][old]
        cut = cut and np.hypot(*way) > PACK
        take[frame] = take[max(frame - 1, 0)] + cut
    rows, sigma = np.arange(replay.num_frames), SMOOTHING_S * replay.step_hz
    x, y = columns.x[rows, subject], columns.y[rows, subject]
    yaw = columns.yaw[rows, subject]
    aside_x, aside_y = columns.x[rows, rival] - x, columns.y[rows, rival] - y
    aside = np.cos(yaw) * aside_y - np.sin(yaw) * aside_x  # how far left the other one is [m]
    aside *= 0.5 * (2.0 - 2.0 * gap / ATTACK).clip(0.0, 1.0)
    x -= aside * np.sin(yaw) + np.abs(aside) * np.cos(yaw)
    y += aside * np.cos(yaw) - np.abs(aside) * np.sin(yaw)
    for number in range(int(take[-1]) + 1):
        within = take == number
        x[within] = gaussian_filter1d(x[within], sigma / 3, mode="nearest")
        y[within] = gaussian_filter1d(y[within], sigma / 3, mode="nearest")
        yaw[within] = gaussian_filter1d(np.unwrap(yaw[within]), sigma, mode="nearest")
    return ChasePath(x, y, yaw, take, tuple(fights))
