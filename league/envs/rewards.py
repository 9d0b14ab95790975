"""What pays: the Reward protocol, and the built-in one, a weighted sum of small batched terms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import torch
from torch import Tensor

from league.envs.config import RewardConfig
from league.errors import ConfigError, nearest_names
from league.sim.referee import Verdict
from league.sim.world import World
from league.track.course import TrackSet

PRESETS = {
    "centerline": RewardConfig(progress=0.0, centerline=1.0, off_track=0.0, crash=0.0),
    "progress": RewardConfig(progress=3.0, off_track=-3.0, crash=-3.0),
    "race": RewardConfig(progress=1.0, overtake=10.0, gain=4.0, off_track=-1.0, crash=-2.0),
}
"""Ready weights by name: of order 1 for a step (4 m/s are 0.27 m, or 0.8), so that a learner
that discounts by 0.99 sees returns of some tens; a mistake costs what a second of racing earns. In
`race` little is paid for progress: a mistake ends the episode and with it all that would have been
earned, and where that is more than a pass earns nobody tries one (docs/self_play.md)."""


class Reward(Protocol):
    """Pays each car for each step; it may remember, so it is told when an episode begins."""

    @property
    def terms(self) -> tuple[str, ...]:
        """Names under which it logs, the same on every step."""
        ...

    def __call__(
        self, tracks: TrackSet, before: World, world: World, actions: Tensor, verdict: Verdict
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Return what each car earns and each term of it by name, all (num_worlds, num_cars).

        Args:
            tracks: the courses.
            before: the worlds before the step.
            world: the worlds after it, before any penalty or restart moved a car.
            actions: what was asked for, in [-1, 1], (num_worlds, num_cars, 2).
            verdict: what happened in the step.
        """
        ...

    def restart(self, world: World, who: Tensor) -> None:
        """Learn which cars begin an episode in this world, bool, (num_worlds, num_cars)."""
        ...


class BuiltIn:
    """The weighted sum of the terms below; it remembers nothing."""

    def __init__(self, cfg: RewardConfig) -> None:
        """Keep the weights."""
        self.cfg = cfg

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the terms that count."""
        return self.cfg.terms

    def __call__(
        self, tracks: TrackSet, before: World, world: World, actions: Tensor, verdict: Verdict
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the weighted sum and each weighted term; see Reward."""
        return total(tracks, self.cfg, world, verdict)

    def restart(self, world: World, who: Tensor) -> None:
        """Nothing is remembered, so nothing is forgotten."""


def preset(name: str, others: Sequence[str] = ()) -> RewardConfig:
    """Return ready weights: `centerline`, `progress` or `race`.

    Args:
        name: which.
        others: more names that would have been understood.

    Raises:
        ConfigError: there are none of this name.
    """
    if name not in PRESETS:
        raise ConfigError(
            f"there is no built-in reward {name!r}; nearest: "
            f"{nearest_names(name, [*PRESETS, *others])}; "
            "or give the path of a reward file that ends in .py"
        )
    return PRESETS[name]


def total(
    tracks: TrackSet, cfg: RewardConfig, world: World, verdict: Verdict
) -> tuple[Tensor, dict[str, Tensor]]:
    """Return the weighted sum and each weighted term, all (num_worlds, num_cars).

    Args:
        tracks: the courses.
        cfg: weights; terms of weight 0 are not computed.
        world: the worlds after the step, before any penalty or restart moved a car.
        verdict: what happened in the step.
    """
    terms: dict[str, Tensor] = {}
    for name, term in _TERMS.items():
        weight = getattr(cfg, name)
        if weight:
            terms[name] = weight * term(tracks, world, verdict)
    result = torch.zeros_like(verdict.advance)
    for value in terms.values():
        result = result + value
    return result, terms


def progress(tracks: TrackSet, world: World, verdict: Verdict) -> Tensor:
    """Metres along the track; signed, so that driving back and forth earns nothing."""
    return verdict.advance


def centerline(tracks: TrackSet, world: World, verdict: Verdict) -> Tensor:
    """The classic three bands: 1 within 10 % of the width of the centre, 0.5 in 25, 0.1 in 50 %.

    After the first example of the DeepRacer developer guide.
    """
    _, _, frame = tracks.at(world.track, world.standing.s)
    share = world.standing.lateral.abs() / (frame.left + frame.right)
    bands = torch.where(share <= 0.25, 0.5, torch.where(share <= 0.5, 0.1, 0.001))
    return torch.where(share <= 0.1, 1.0, bands)


def _flag(name: str):  # noqa: ANN202
    def term(tracks: TrackSet, world: World, verdict: Verdict) -> Tensor:
        return getattr(verdict, name).to(verdict.advance.dtype)

    return term


def overtake(tracks: TrackSet, world: World, verdict: Verdict) -> Tensor:
    """Cars passed on the road, minus cars that passed."""
    won = verdict.overtook.to(torch.int64).sum(dim=2) - verdict.overtook.to(torch.int64).sum(dim=1)
    return won.to(verdict.advance.dtype)


def gain(tracks: TrackSet, world: World, verdict: Verdict) -> Tensor:
    """Metres gained in this step on each other car within 1.5 m along the track, summed over them.

    A pass that pays only once it is done is hardly ever found by chance; this pays on the way to
    it. After Fuchs et al., "Super-Human Performance in Gran Turismo Sport" (2021), and Song et al.,
    "Autonomous Overtaking in Gran Turismo Sport" (2021), section IV.
    """
    book = world.standing
    s = book.s
    moving = (book.penalty_s == 0) & ~verdict.released & torch.isinf(book.finish_s)
    away = tracks.signed_gap(world.track, s.unsqueeze(2), s.unsqueeze(1)).abs()
    near = (away < _NEAR) & moving.unsqueeze(1) & moving.unsqueeze(2)
    more = verdict.advance.unsqueeze(2) - verdict.advance.unsqueeze(1)  # [w, i, j]: i than j
    return torch.where(near, more, 0.0).sum(dim=2)


_NEAR = 1.5
_TERMS = {
    "progress": progress,
    "centerline": centerline,
    "lap": _flag("lap"),
    "overtake": overtake,
    "gain": gain,
    "off_track": _flag("off_track"),
    "crash": _flag("crashed"),
    "contact": _flag("was_hit"),
}
