"""The pool: frozen past selves on disk, few enough to race, spread over the whole past."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean

from league.agents import checkpoint
from league.agents.checkpoint import Checkpoint
from league.atomic_file import replacing
from league.errors import PolicyError

PARENT = "parent"


@dataclass(frozen=True)
class Member:
    """One frozen past self."""

    name: str
    """`parent`, or the updates after which it was taken, as six digits: its file's name."""
    updates: int
    """Updates of the run when it was taken; 0 is the parent."""
    digest: str
    """SHA-256 of its content."""
    forced: bool
    """Whether it entered by its turn, not by winning."""
    measured: float | None
    """Its smallest win rate against the members it was measured against; None: against none."""


@dataclass(frozen=True)
class Candidate:
    """How the learner fared when it raced for a place in the pool."""

    updates: int
    """Updates of the run by then."""
    win_rates: dict[str, float]
    """Against each member it was measured against, by name; empty: there was none."""
    entered: bool
    """Whether it became a member."""
    forced: bool
    """Whether it became one by its turn, not by winning."""

    @property
    def smallest(self) -> float | None:
        """Smallest of its win rates, which decides; None: it was measured against nobody."""
        return min(self.win_rates.values(), default=None)

    @property
    def mean(self) -> float | None:
        """Mean of its win rates; None: it was measured against nobody."""
        return fmean(self.win_rates.values()) if self.win_rates else None


class Pool:
    """Members, oldest first, each with its file `NNNNNN.pt`, and `pool.json` to look at.

    `candidates` are all that raced for a place, in their order, those that were refused too.
    """

    def __init__(self, folder: Path, size: int) -> None:
        """Begin with none.

        Args:
            folder: where the files are.
            size: most members kept.
        """
        self._folder, self._size = folder, size
        self.members: list[Member] = []
        self.candidates: list[Candidate] = []
        self._leaving: list[str] = []

    def path(self, member: Member) -> Path:
        """Return where a member's checkpoint is."""
        return self._folder / f"{member.name}.pt"

    def add(
        self, kept: Checkpoint, updates: int, *, forced: bool, measured: float | None
    ) -> Member:
        """Write a checkpoint and make it a member."""
        name = f"{updates:06d}" if updates else PARENT
        member = Member(name, updates, kept.digest, forced, measured)
        checkpoint.save(self.path(member), kept)
        self.members.append(member)
        return member

    def load(self, member: Member) -> Checkpoint:
        """Read a member's checkpoint.

        Raises:
            PolicyError: it is gone, or not what it was.
        """
        found = checkpoint.load(self.path(member))
        if found.digest != member.digest:
            raise PolicyError(
                f"{self.path(member)} is not the policy it was: put back the file of this run, "
                "or start a new run with another --out"
            )
        return found

    def thin(self, loses_to: Callable[[Member], bool]) -> list[Member]:
        """Let members go until the pool is small enough; return those that went.

        The oldest, the newest and whoever is not beaten stay; of the others goes, again and again,
        the one whose neighbours in age are closest in ratio, so that ages stay spread in powers.
        Files are removed later, by `sweep`: a run that was killed meanwhile still needs them.
        """
        gone: list[Member] = []
        while len(self.members) > self._size:
            gone.append(self.members.pop(_most_crowded(self.members, loses_to)))
        self._leaving += [member.name for member in gone]
        return gone

    def sweep(self) -> None:
        """Remove the files of those that had gone before the last save point."""
        for name in self._leaving:
            (self._folder / f"{name}.pt").unlink(missing_ok=True)
        self._leaving = []

    def write(self, win_rates: dict[str, float]) -> None:
        """Write `pool.json`: members, how often the learner beats each, and all candidates."""
        told = {
            "members": [
                asdict(one) | {"win_rate": win_rates.get(one.name)} for one in self.members
            ],
            "candidates": [
                asdict(one) | {"smallest": one.smallest, "mean": one.mean}
                for one in self.candidates
            ],
        }
        path = self._folder / "pool.json"
        with replacing(path, "the pool's list", PolicyError) as file:
            file.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")

    def state(self) -> dict[str, list[dict[str, object]]]:
        """Return members and candidates as JSON-able data."""
        return {
            "members": [asdict(member) for member in self.members],
            "tried": [asdict(candidate) for candidate in self.candidates],
        }

    def restore(self, members: Sequence[dict], tried: Sequence[dict]) -> None:
        """Go on with these members and candidates; files of others, written later, are removed."""
        self.members, self._leaving = [Member(**told) for told in members], []
        self.candidates = [Candidate(**told) for told in tried]
        known = {member.name for member in self.members}
        for path in self._folder.glob("*.pt"):
            if path.stem not in known:
                path.unlink()


def _most_crowded(members: Sequence[Member], loses_to: Callable[[Member], bool]) -> int:
    """Return the place of the member that is missed least."""
    newest = members[-1].updates
    ages = [newest - member.updates + 1 for member in members]
    inner = range(1, len(members) - 1)
    beaten = [place for place in inner if not loses_to(members[place])]
    # Where everybody must stay, somebody goes all the same.
    return min(beaten or inner, key=lambda place: ages[place - 1] / ages[place + 1])


def spread(members: Sequence[Member], count: int) -> list[Member]:
    """Return at most so many members, with the oldest and the newest, ages spread in powers."""
    kept = list(members)
    while len(kept) > max(count, 2):
        kept.pop(_most_crowded(kept, lambda member: False))
    return kept
