"""How fast rivals can be passed at all, by an attacker that knows what the defender will do.

    python -m benchmarks.pass_limit [--races 30] [--plans 32] TRUTH.pt [--defender NAME]
        [--shares 0.78 0.82 0.86 0.9 1]

TRUTH.pt is a policy of `league train --self-play --sensors truth`. The attacker searches: every
third of a second it tries many plans, random changes of what the policy would do during the next
second, each in the simulator against the defender's real answers, and goes on with the one that is
farthest ahead two seconds after it. What it finds is a lower bound of what is possible.
"""

import argparse

import numpy as np

from benchmarks.report import heading, note, table, without_traceback
from league.agents import roster
from league.agents.rollout import DriverPool
from league.envs.driver import Driver
from league.racing import duels
from league.racing.duels import DuelConfig
from league.sim.config import CarConfig
from league.track import files
from league.track.track import TrackSet

SHARES = (0.78, 0.82, 0.86, 0.90, 1.0)
"""Top speeds of the defender, as shares of the car's, unless others are given."""
ROUND, PIECES = 5, 3
"""Control steps between two choices, a third of a second, and how many such rounds a plan has."""
HORIZON = 45
"""Control steps after which plans are compared; after its pieces the policy drives."""
CHANGE = (0.35, 0.4)
"""Standard deviation of the changes of steering and speed, of actions in [-1, 1]."""
CHANGED = 0.6
"""Share of the pieces of a plan in which each of them is changed."""


class Search:
    """Races of an attacker that tries plans before it drives; a row is one plan of one race."""

    def __init__(
        self, cfg: DuelConfig, attacker: Driver, defender: Driver, share: float, plans: int
    ) -> None:
        """Put the cars on the grid.

        Args:
            cfg: the races, those of `duels.from_behind`.
            attacker: proposes the actions that plans change.
            defender: another object than the attacker.
            share: the defender's top speed, as a share of the car's.
            plans: of each race at each choice.
        """
        self._races, self._plans, rows = cfg.races, plans, cfg.races * plans
        self._env = duels.make_env(cfg, (defender, attacker), rows)
        self._drivers = DriverPool([(defender, attacker)] * rows, strict=True)
        self._env.reset(seeds=np.repeat(duels.seeds(cfg), plans))
        self._cars = self._env.world.cars
        self._cars["top_speed"] = (
            np.array((share, 1.0), np.float32) * self._env.cfg.sim.car.max_speed
        )
        self._failed, self._over, self._won = (np.zeros(rows, np.bool_) for _ in range(3))
        self._random = np.random.default_rng(cfg.seed)

    def run(self) -> float:
        """Drive all races; return the share that the attacker wins without a mistake."""
        plan = np.zeros((self._races, PIECES, 2), np.float32)
        for _ in range(0, int(self._env.world.worlds["last_step"].max()), ROUND):
            if (self._over | self._failed).all():
                break
            plans = self._propose(plan)
            plan = plans[self._try(plans)]
        self._env.close()
        return float(self._won.reshape(self._races, -1)[:, 0].mean())

    def _propose(self, plan: np.ndarray) -> np.ndarray:
        """Return changes (rows, PIECES, 2): none, the rest of the last plan, and random ones."""
        shape = (self._races, self._plans, PIECES, 2)
        plans = self._random.normal(0.0, CHANGE, shape).astype(np.float32)
        plans[self._random.random(shape) > CHANGED] = 0.0
        plans[:, :2] = 0.0
        plans[:, 1, :-1] = plan[:, 1:]
        return plans.reshape(-1, PIECES, 2)

    def _try(self, plans: np.ndarray) -> np.ndarray:
        """Drive all plans to the horizon, then go on in each race with the first round of the best.

        Returns its row in each race, int64 (races,).
        """
        for _ in range(ROUND):
            self._step(plans[:, 0])
        world, flags = self._env.world.copy(), (self._failed, self._over, self._won)
        for step in range(ROUND, HORIZON):
            piece = step // ROUND
            self._step(plans[:, piece] if piece < PIECES else 0.0)
        lead = self._cars["distance"][:, 1] - self._cars["distance"][:, 0]
        lead[self._won] = np.inf
        lead[self._failed | (self._over & ~self._won)] = -np.inf
        best = lead.reshape(self._races, -1).argmax(axis=1) + np.arange(self._races) * self._plans
        rows = np.repeat(best, self._plans)
        self._failed, self._over, self._won = (of[rows] for of in flags)
        self._env.restore(world.rows(rows))
        return best

    def _step(self, change: np.ndarray | float) -> None:
        actions = self._drivers.act(self._env.observations)
        actions[:, 1] = np.clip(actions[:, 1] + change, -1.0, 1.0)
        seen = self._env.step(actions)
        verdicts = seen.verdicts[:, 1]
        mistake = verdicts["to_blame"] | verdicts["off_track"] | verdicts["pushed_off"]
        # New arrays: `_try` keeps those of its first round.
        self._failed = self._failed | (mistake & ~self._over)
        ended = seen.terminated.any(axis=1) & ~self._over
        ahead = self._cars["finish_s"][:, 1] < self._cars["finish_s"][:, 0]
        self._won = self._won | (ended & ahead & ~self._failed)
        self._over = self._over | ended


@without_traceback()
def main(arguments: list[str] | None = None) -> None:
    """Compare a policy with the search at several paces of the defender."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("policy")
    parser.add_argument("--defender", help="the policy itself, slowed, unless given")
    parser.add_argument("--races", type=int, default=30)
    parser.add_argument("--plans", type=int, default=32)
    parser.add_argument("--track", default="reinvent_2018")
    parser.add_argument("--shares", type=float, nargs="+", default=SHARES)
    given = parser.parse_args(arguments)
    track = files.load(given.track)
    cfg, tracks = DuelConfig(track, races=given.races), TrackSet(track)

    def load(name: str) -> Driver:
        return roster.load(name, tracks, CarConfig())

    rival = given.defender or given.policy
    own = duels.solo_lap(cfg, load(given.policy))
    heading(f"{given.policy} behind {rival} on {track.name}, {cfg.races} races at each pace")
    row = table("pace of the defender", "policy: passed cleanly", "search: passed cleanly")
    for share in given.shares:
        pace = own / duels.solo_lap(cfg, load(rival), share)
        alone = duels.from_behind(cfg, (load(rival), load(given.policy)), (share, 1.0))
        found = Search(cfg, load(given.policy), load(rival), share, given.plans).run()
        row(f"{pace:.3f}", f"{alone.clean:.2f}", f"{found:.2f}")
    note(f"Planar solver; {given.plans} plans at each choice.")


if __name__ == "__main__":
    main()
