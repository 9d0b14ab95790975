"""Which solver a name means; PyBullet is loaded only where it is asked for."""

from league.sim.config import SimConfig, SolverName
from league.sim.planar import PlanarSolver
from league.sim.solver import Solver
from league.track.course import TrackSet


def make(name: SolverName, cfg: SimConfig, tracks: TrackSet, num_worlds: int) -> Solver:
    """Build the solver of this name."""
    if name == "planar":
        return PlanarSolver(cfg, tracks)
    from league.sim.bullet import BulletSolver

    return BulletSolver(cfg, tracks, num_worlds)
