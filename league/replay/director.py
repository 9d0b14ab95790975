"""The camera's director: follows the closest fight, and cuts when it is decided."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from league.replay.commentary import APART, ATTACK, LEVEL, Cars, gap_s, gaps_m, moments
from league.replay.replay import Replay

PACK = 3.0  # two cars this close along the track [m] are in one picture
SHORTEST_S = 2.5  # no shot is shorter [s]
HOLD_S = 1.5  # a fight that is decided is still shown for so long [s]
CLOSER = 0.5  # another fight is worth a cut if its gap is at most this share of the present one's
SMOOTHING_S = 0.45  # how slowly the chase camera turns; it moves three times as fast [s]


@dataclass(frozen=True)
class Shot:
    """What a camera shows."""

    front: int  # the car in front of a fight, or a car alone
    rear: int  # the car behind, from behind which both are seen; `front` if it is alone
    since_s: float  # when the shot began [s]

    def sentence(self, names: tuple[str, ...], cars: Cars) -> str:
        """Return who attacks and the gap in seconds; empty where no car is near."""
        gap = abs(float(cars["distance"][self.front] - cars["distance"][self.rear]))
        if self.front == self.rear or gap > APART:
            return ""
        front, rear = names[self.front], names[self.rear]
        if gap < LEVEL:
            return f"{rear} and {front} side by side"
        does = "attacks" if gap < ATTACK else "chases"
        return f"{rear} {does} {front}, {gap_s(cars, self.front, self.rear):.1f} s"


class Director:
    """Chooses what to show step by step; the same for a film and a live view."""

    def __init__(self) -> None:
        self.shot: Shot | None = None  # what is shown; None before the first step
        self._open_s = 0.0  # when the fight of this shot was last undecided

    def add(self, time_s: float, cars: Cars) -> Shot:
        """Return what to show at a step that follows the one before."""
        gaps = gaps_m(cars)
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
        best = _best(gaps, cars, time_s)
        decided = time_s - self._open_s >= HOLD_S
        other = {best.front, best.rear} != {shot.front, shot.rear}
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
    """Return where to chase from: behind the rear car of the fight that is shown."""
    from scipy.ndimage import gaussian_filter1d  # late: SciPy takes a while

    columns, director = replay.columns, Director()
    subject = np.empty(replay.num_frames, np.int64)
    take, fights = np.zeros(replay.num_frames, np.int64), []
    for frame, (time_s, cars) in enumerate(moments(replay)):
        before, shot = director.shot, director.add(time_s, cars)
        if replay.spec.format == "pursuit":
            # A gap of nothing may be half a lap of road: the winner is followed.
            winner = replay.result.order[0].car
            shot = Shot(winner, winner, 0.0)
        subject[frame] = shot.rear
        fights.append(shot.sentence(replay.names, cars))
        cut = before is not None and before.since_s != shot.since_s > 0.0
        # A short way is gone rather than cut: a jump by a car's length looks like a fault.
        old = subject[max(frame - 1, 0)]
        way = cars["x"][shot.rear] - cars["x"][old], cars["y"][shot.rear] - cars["y"][old]
        cut = cut and np.hypot(*way) > PACK
        take[frame] = take[max(frame - 1, 0)] + cut
    rows, sigma = np.arange(replay.num_frames), SMOOTHING_S * replay.step_hz
    x, y = columns.x[rows, subject], columns.y[rows, subject]
    yaw = columns.yaw[rows, subject]
    for number in range(int(take[-1]) + 1):
        within = take == number
        x[within] = gaussian_filter1d(x[within], sigma / 3, mode="nearest")
        y[within] = gaussian_filter1d(y[within], sigma / 3, mode="nearest")
        yaw[within] = gaussian_filter1d(np.unwrap(yaw[within]), sigma, mode="nearest")
    return ChasePath(x, y, yaw, take, tuple(fights))
