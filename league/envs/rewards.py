"""Built-in rewards: small batched terms, one weighted sum, each logged by its name."""

import torch
from torch import Tensor

from league.envs.config import RewardConfig
from league.sim.referee import Verdict
from league.sim.world import World
from league.track.course import TrackSet


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


_TERMS = {
    "progress": progress,
    "centerline": centerline,
    "lap": _flag("lap"),
    "overtake": overtake,
    "off_track": _flag("off_track"),
    "crash": _flag("crashed"),
    "contact": _flag("was_hit"),
}
