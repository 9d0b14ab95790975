"""The pool: frozen past selves on disk, spread over the whole past of a run."""

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
    """`parent`, or the number of updates as six digits: its file's name."""
    updates: int
    """Updates of the run when it was saved; 0 is the parent."""
    digest: str
    """SHA-256 of its content."""
    forced: bool
    """Whether it entered by turn, not by winning."""
    measured: float | None
    """Its smallest win rate as a candidate; None: it had no rival."""


@dataclass(frozen=True)
class Candidate:
    """The learner's races for a place in the pool."""

    updates: int
    """Updates of the run by then."""
    win_rates: dict[str, float]
    """Against each rival, by name."""
    entered: bool
    """Whether it became a member."""
    forced: bool
    """Whether it became one by turn, not by winning."""

    @property
    def smallest(self) -> float | None:
        """Smallest of its win rates, which decides; None without a rival."""
        return min(self.win_rates.values(), default=None)

    @property
    def mean(self) -> float | None:
        """Mean of its win rates; None without a rival."""
        return fmean(self.win_rates.values()) if self.win_rates else None


class Pool:
    """Members, oldest first, each with a file `NNNNNN.pt`, all candidates, and `pool.json`."""

    def __init__(self, folder: Path, size: int) -> None:
        self._folder, self._size = folder, size
        self.members: list[Member] = []
        self.candidates: list[Candidate] = []
        self._removed: list[str] = []

    def add(
        self, snapshot: Checkpoint, updates: int, *, forced: bool, measured: float | None
    ) -> Member:
        """Write a checkpoint and make it a member."""
        name = f"{updates:06d}" if updates else PARENT
        member = Member(name, updates, snapshot.digest, forced, measured)
        checkpoint.save(self._path(member), snapshot)
        self.members.append(member)
        return member

    def load(self, member: Member) -> Checkpoint:
        """Read a member's checkpoint.

        Raises:
            PolicyError: it is missing, or was changed.
        """
        snapshot = checkpoint.load(self._path(member))
        if snapshot.digest != member.digest:
            raise PolicyError(
                f"{self._path(member)} is not the policy it was: put back the file of this run, "
                "or start a new run with another --out"
            )
        return snapshot

    def thin(self, loses_to: Callable[[Member], bool]) -> list[Member]:
        """Remove members until the pool is small enough; return the removed ones.

        The oldest, the newest and those that beat the learner stay; of the others the one whose
        neighbours in age are closest in ratio is removed, so that ages stay spread in powers.
        Files are removed later, by `sweep`: a run that is killed before it still needs them.
        """
        removed: list[Member] = []
        while len(self.members) > self._size:
            removed.append(self.members.pop(_most_crowded(self.members, loses_to)))
        self._removed += [member.name for member in removed]
        return removed

    def sweep(self) -> None:
        """Remove the files of members that were removed before the last save point."""
        for name in self._removed:
            (self._folder / f"{name}.pt").unlink(missing_ok=True)
        self._removed = []

    def _path(self, member: Member) -> Path:
        return self._folder / f"{member.name}.pt"

    def write(self, win_rates: dict[str, float]) -> None:
        """Write `pool.json`: members, how often the learner beats each, and all candidates."""
        content = {
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
            file.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")

    def state(self) -> dict[str, list[dict[str, object]]]:
        """Return members and candidates as JSON-able data."""
        return {
            "members": [asdict(member) for member in self.members],
            "tried": [asdict(candidate) for candidate in self.candidates],
        }

    def restore(self, members: Sequence[dict], tried: Sequence[dict]) -> None:
        """Take over members and candidates of a state; remove files that were written later."""
        self.members, self._removed = [Member(**member) for member in members], []
        self.candidates = [Candidate(**candidate) for candidate in tried]
        known = {member.name for member in self.members}
        for path in self._folder.glob("*.pt"):
            if path.stem not in known:
                path.unlink()


def _most_crowded(members: Sequence[Member], loses_to: Callable[[Member], bool]) -> int:
    """Return the index of the member that should be removed first."""
    newest = members[-1].updates
    ages = [newest - member.updates + 1 for member in members]
    inner = range(1, len(members) - 1)
    beaten = [index for index in inner if not loses_to(members[index])]
    return min(beaten or inner, key=lambda index: ages[index - 1] / ages[index + 1])


def spread(members: Sequence[Member], count: int) -> list[Member]:
    """Return at most so many members, with the oldest and the newest, ages spread in powers."""
    kept = list(members)
    while len(kept) > max(count, 2):
        kept.pop(_most_crowded(kept, lambda member: False))
    return kept
