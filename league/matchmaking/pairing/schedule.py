"""Who races whom next: a pure function of the standings, the history and a generator.

Connection comes first: whoever has no chain of races to the pinned anchor gets one. Three lanes
share the other heats. Coverage begins with whoever is least sure, so that newcomers are rated soon.
Informed asks the closest questions. Random ties the whole field together: without it a field raced
only among neighbours becomes a chain whose ends drift apart.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from league.matchmaking.pairing.grids import Grids
from league.matchmaking.pairing.plans import (
    RATED_STATES,
    HeatPlan,
    Lane,
    PairCounts,
    PairingSettings,
    RacePlan,
    Standing,
    State,
)

__all__ = [
    "RATED_STATES",
    "HeatPlan",
    "Lane",
    "PairCounts",
    "PairingSettings",
    "RacePlan",
    "Standing",
    "State",
    "next_heats",
    "next_state",
    "validation_heats",
]


def next_state(
    state: State, sd: float, *, validated: bool = False, settings: PairingSettings
) -> State:
    """Return where an entry stands after a refit.

    Args:
        state: where it stood.
        sd: standard deviation of its rating [Elo].
        validated: whether its validation heats went well.
        settings: the limits.
    """
    if state in ("pending", "retired"):
        return state
    if state == "validating" and not validated:
        return state
    if sd > settings.placement_sd:
        return "placement"
    return "provisional" if sd > settings.provisional_sd else "ranked"


def validation_heats(
    standing: Standing,
    standings: Sequence[Standing],
    settings: PairingSettings,
    generator: np.random.Generator,
) -> list[HeatPlan]:
    """Plan an entry's way in: a race against itself, and one against an anchor if there is one."""
    tracks = generator.choice(settings.tracks, size=2)
    own = RacePlan(str(tracks[0]), (standing.entry, standing.entry))
    heats = [HeatPlan("validation", (own,), rated=False)]
    anchors = [s.entry for s in standings if s.anchor and s.entry != standing.entry]
    if anchors:
        anchor = int(generator.choice(anchors))
        race = RacePlan(str(tracks[1]), (standing.entry, anchor))
        heats.append(HeatPlan("validation", (race,), rated=False))
    return heats


def next_heats(
    standings: Sequence[Standing],
    counts: PairCounts,
    settings: PairingSettings,
    generator: np.random.Generator,
    *,
    heats: int | None = None,
) -> list[HeatPlan]:
    """Plan a round of rated heats.

    Args:
        standings: all entries; those not in a rated state are left out.
        counts: how often pairs have met, planned heats included.
        settings: the league's choices.
        generator: where chance comes from.
        heats: how many; by default half as many as there are entries, so that workers do not
            wait for a refit and no plan is older than a round.

    Returns:
        Fewer heats than asked for, none at worst, if nobody is left whom the rules let meet.
    """
    field_ = [s for s in standings if s.state in RATED_STATES]
    if len(field_) < 2:
        return []
    table = Grids.of(field_, counts, settings, generator)
    wanted = max(1, len(field_) // 2) if heats is None else heats
    plans = []
    lanes = _lanes(wanted, settings, generator)
    with_anchor = _quota(wanted, settings.anchor_share, generator)
    for lane, anchored in zip(lanes, with_anchor, strict=True):
        grid = table.joining()
        if grid is not None:
            lane = "connection"
        else:
            grid = table.grid(lane, bool(anchored))
        if grid is None:
            continue
        table.note(grid)
        entries = tuple(int(table.entries[index]) for index in grid)
        plans.append(HeatPlan(lane, _halves(entries, settings, generator)))
    return plans


def _quota(wanted: int, share: float, generator: np.random.Generator) -> np.ndarray:
    """Return which of some heats have a trait: a share of them to within one, in random order."""
    whole, rest = divmod(wanted * share, 1.0)
    marked = np.zeros(wanted, dtype=bool)
    marked[: int(whole) + int(generator.random() < rest)] = True
    return generator.permutation(marked)


def _lanes(wanted: int, settings: PairingSettings, generator: np.random.Generator) -> list[Lane]:
    """Return the lane of each heat; the shares are kept to within one heat."""
    ends = np.cumsum([settings.coverage_share, settings.informed_share])
    # One random shift of evenly spaced points keeps every share as even as it can be.
    points = (np.arange(wanted) + generator.random()) / max(wanted, 1)
    which = np.searchsorted(ends, generator.permutation(points), side="right")
    names: tuple[Lane, ...] = ("coverage", "informed", "random")
    return [names[int(place)] for place in which]


def _halves(
    entries: tuple[int, ...], settings: PairingSettings, generator: np.random.Generator
) -> tuple[RacePlan, ...]:
    """Return a heat's two races: the grid reversed, and another track if there are enough."""
    second_too = len(settings.tracks) >= settings.other_track_from
    tracks = generator.choice(settings.tracks, size=1 + second_too, replace=False)
    return (
        RacePlan(str(tracks[0]), entries),
        RacePlan(str(tracks[-1]), entries[::-1]),
    )
