"""Settings of self-play; docs/self_play.md gives the experiments behind them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from league.envs.config import OpponentPlacement
from league.errors import ConfigError
from league.sim.config import DynamicsRandomization

PACER_SHARE = 0.5
"""Part of the scripted drivers' share that pacers have; `centerline` has the rest."""
FIRST_PACES, LAST_PACES = (0.4, 0.6), (0.55, 0.8)
"""Range of slow opponents' paces at first and at last: share of the racing line's pace for pacers,
and of its top speed for a member of the pool."""
BEATEN = 0.5
"""Mean win rate against slow opponents at which they become faster."""
PACE_RATE = 2.0
"""Largest rate at which they do: full ranges per run after its warm-up."""


@dataclass(frozen=True)
class MatchConfig:
    """A measuring race of two drivers."""

    laps: int = 2
    """Laps of a race; the second is a flying one."""
    spread: DynamicsRandomization = field(
        default_factory=lambda: DynamicsRandomization(grip=0.01, mass=0.01, steering_offset=0.003)
    )
    """Differences between the cars, without which all races of two drivers would be equal.
    Mirrored races swap the drivers, not the cars, so they favour neither."""
    slowest: float = 1.2
    """Mean speed [m/s] that sets the time limit of a race, with `grace_s` on top."""
    grace_s: float = 10.0
    """For a start and two penalties [s]."""
    at_once: int = 128
    """Races in a batch."""


@dataclass(frozen=True)
class SelfPlayConfig:
    """How opponents are drawn, and which past selves are kept."""

    newest: float = 0.35
    """Share of episodes against the learner's own weights of the last save point."""
    prioritised: float = 0.45
    """Share against members of the pool, each in proportion to (1 - win rate) squared."""
    hardest: float = 0.10
    """Share against the member with the smallest win rate."""
    scripted: float = 0.10
    """Share against scripted drivers; only where all worlds are on one track."""
    handicap: bool = True
    """Whether members of the pool have speed limits, so that they can be passed, and the learner in
    some of its lone episodes, so that its later self can drive under one."""
    warm_up: float = 0.3
    """Part of the run, at its start, in which the learner drives alone except on starting grids: a
    policy that does not drive well alone does not learn to pass. The learner's schedules run
    through once for this part and once for the rest."""
    pool_size: int = 48
    """Most members kept."""
    candidate_every: int = 16
    """Updates between two candidates; they come at save points."""
    forced_every: int = 4
    """Every so many candidates one enters without winning."""
    admission: float = 0.55
    """Smallest win rate against every member that is measured, to enter."""
    rivals: int = 6
    """Members that a candidate races, the hardest first."""
    races: int = 8
    """Races against each of them, half from either slot."""
    matrix_members: int = 8
    """Members in the payoff matrix, spread over the run in ratios of age."""
    matrix_races: int = 16
    """Races of each pair in the payoff matrix, half from either slot."""
    match: MatchConfig = field(default_factory=MatchConfig)
    """The measuring races."""

    def __post_init__(self) -> None:
        if not 0 <= self.warm_up < 1:
            raise ConfigError(f"warm_up is {self.warm_up}: give a share from 0 to below 1")
        for name in ("races", "matrix_races"):
            if getattr(self, name) < 2 or getattr(self, name) % 2:
                raise ConfigError(
                    f"{name} is {getattr(self, name)}: give an even number, half for either slot"
                )

    def with_scripted(self, share: float) -> SelfPlayConfig:
        """Return the settings with another share of scripted drivers, the rest in proportion."""
        if not 0 <= share < 1:
            raise ConfigError(f"the share of scripted drivers is {share}: give 0 to below 1")
        rest = (1.0 - share) / (1.0 - self.scripted)
        return replace(
            self,
            newest=self.newest * rest,
            prioritised=self.prioritised * rest,
            hardest=self.hardest * rest,
            scripted=share,
        )

    def meeting(self, done: float, num_cars: int = 2) -> OpponentPlacement:
        """Return how so many cars meet at a share `done` of the run."""
        usual, more = OpponentPlacement(), max(num_cars - 4, 0)
        # More than four near the learner would overlap, and those at the far end of a starting
        # grid, 0.75 m for each car, would count as left behind at once.
        usual = replace(usual, reach=usual.reach + 0.5 * more, lost=usual.lost + 0.8 * more)
        if done >= self.warm_up:
            return usual
        return replace(usual, alone=1.0 - usual.standing)

    def part_done(self, done: float) -> float:
        """Return how much of the warm-up, or else of the rest, is done: 0 to 1 twice."""
        if done < self.warm_up:
            return done / self.warm_up
        return (done - self.warm_up) / (1.0 - self.warm_up)

    def quicker(self, quickness: float, win_rate: float, before: float, done: float) -> float:
        """Return where slow opponents are between first (0) and last paces (1).

        Args:
            quickness: where they were when a share `before` of the run was done.
            win_rate: the learner's mean win rate against them.
            before: share of the run that was done then.
            done: share that is done now.
        """
        if done < self.warm_up or win_rate < BEATEN:
            return quickness
        # Smaller than before in a resumed run with a larger budget.
        passed = max(done - max(before, self.warm_up), 0.0) / (1.0 - self.warm_up)
        return min(quickness + PACE_RATE * passed, 1.0)


def paces(quickness: float) -> tuple[float, float]:
    """Return the range of paces between first (0) and last ones (1)."""
    least, most = (a + quickness * (b - a) for a, b in zip(FIRST_PACES, LAST_PACES, strict=True))
    return least, most
