"""How many rated duels a league races in a day, with camera policies, and where the time goes.

The policies are those named on the command line, or the garage's duelist and racer; their names are
printed with the figures.
"""

import cProfile
import multiprocessing
import os
import pstats
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from math import nan
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path

from benchmarks.report import figure, heading, note
from league import subprocesses
from league.agents import checkpoint
from league.agents.checkpoint import Checkpoint
from league.matchmaking import loop, submission
from league.matchmaking import workers as executors
from league.matchmaking.loop import Dispatcher, heat_driver
from league.matchmaking.pairing import matchmaker
from league.matchmaking.pairing.heat_spec import Half, Heat, Ruleset, mirrored
from league.matchmaking.store import Store, create
from league.matchmaking.workers.worker import HeatJob, RaceWorker
from league.sim.config import SolverName

GOAL_A_DAY, GOAL_A_DAY_PLANAR = 150_000, 500_000
MINUTE_S = 60.0
GARAGE = ("garage/duelist.pt", "garage/racer.pt")
SHARES = {
    "physics": ("solver", "bullet.py", "step"),
    "referee": ("controls, referee and penalties", "step.py", "step"),
    "sensors": ("cameras and lidars", "sensor_suite.py", "read"),
    "inference": ("inference", "policy.py", "act"),
    "recording": ("recording", "replay.py", "add"),
}


def policies(paths: list[str]) -> list[Checkpoint]:
    """Return two camera policies: those named, or the garage's; one alone races its own clone."""
    named = paths or [path for path in GARAGE if Path(path).exists()]
    found = [checkpoint.load(path) for path in named]
    seeing = [one for one in found if one.card.sensors.camera is not None]
    return (seeing * 2)[:2]


def league(folder: Path, drivers: list[Checkpoint], solver: SolverName = "bullet") -> Store:
    """Return a league in which the drivers wait to be paired, and no others."""
    store = create(f"sqlite:///{folder / f'{solver}.db'}", ruleset=Ruleset(laps=3, solver=solver))
    for number, one in enumerate(drivers):
        card = {**one.card.model_dump(), "name": f"{one.card.name} {number}"}
        renamed = Checkpoint(type(one.card)(**card), one.weights)
        submission.accept(store, submission.pack(renamed), f"policy {number}", f"owner {number}")
    matchmaker.enter_anchors(store, ())
    return store


def shares(store: Store) -> None:
    """Print where the time of one heat goes, after one to warm up."""
    entries = store.entries()
    rules = store.settings.ruleset
    half = Half(rules.tracks[0], tuple(entry.id for entry in entries))
    field = {entry.id: heat_driver(store, entry) for entry in entries}
    heat = Heat(rules.hash, (half,))
    job = HeatJob(heat.key, 1, heat.halves, (5,), rules, field)
    worker = RaceWorker()
    worker.race(job)
    profile = cProfile.Profile(time.process_time)
    start = time.process_time()
    profile.enable()
    report = worker.race(job)
    profile.disable()
    total = time.process_time() - start
    assert report.outcome is not None, report.traceback
    stats = pstats.Stats(profile).stats  # pyright: ignore[reportAttributeAccessIssue]
    whole = max(timing[3] for timing in stats.values())
    note(f"one race of {report.race_s:.1f} s in {total:.2f} s of one core, under a profiler:")
    for name, file, function in SHARES.values():
        spent = sum(
            timing[3] for (path, _, called), timing in stats.items()
            if path.endswith(file) and called == function and "league" in path
        )  # fmt: skip
        figure(f"  share of {name}", 100 * spent / whole, "%")


def batching(store: Store, repeats: int = 3) -> None:
    """Print what racing both halves of a heat as one batch brings, side by side."""
    entries, rules = store.entries(), store.settings.ruleset
    heat = mirrored(
        rules.hash, (rules.tracks[0], rules.tracks[0]), tuple(entry.id for entry in entries)
    )
    field = {entry.id: heat_driver(store, entry) for entry in entries}
    job = HeatJob(heat.key, 1, heat.halves, (5, 6), rules, field)
    worker, ratios = RaceWorker(), list[float]()
    each = zip(job.halves, job.seeds, strict=True)
    halves = [replace(job, halves=(half,), seeds=(seed,)) for half, seed in each]
    for repeat in range(repeats + 1):
        start = time.process_time()
        alone = [worker.race(one).outcome for one in halves]
        middle = time.process_time()
        together = worker.race(job).outcome
        end = time.process_time()
        assert together is not None
        assert together.races == tuple(one.races[0] for one in alone if one is not None)
        if repeat:  # the first one warms up
            ratios.append((middle - start) / (end - middle))
    figure("both halves as one batch instead of in turn", statistics.median(ratios), "x faster")


def throughput(store: Store, solver: SolverName, seconds: float, workers: int, goal: float) -> None:
    """Print duels of a minute a day, whole: matchmaker, store, replays, ratings and all."""
    planner = matchmaker.Matchmaker(store)
    with closing(executors.make_executor("processes", workers)) as executor:
        dispatcher = Dispatcher(store, executor)
        loop.run(store, dispatcher, planner, heats=2 * workers)  # workers have warmed up
        start = time.perf_counter()
        tally = loop.run(store, dispatcher, planner, seconds=seconds)
        wall_s = time.perf_counter() - start
    minutes = tally.race_s / MINUTE_S
    figure("race time per wall second, workers warm", tally.race_s / wall_s, "x real time")
    figure(
        "one worker, matchmaker and store left out", tally.race_s / tally.worker_s, "x real time"
    )
    figure(f"rated one-minute duels a day, {solver}", 86_400 * minutes / wall_s, "duels", goal)
    figure("heats raced", tally.heats, "heats")


def _memory(pid: int) -> float:
    """Return the memory of a process, of what it shares its part [MB]."""
    text = Path(f"/proc/{pid}/smaps_rollup").read_text()
    return float(text.split("Pss:")[1].split()[0]) / 1024


def _parent(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[1])


def _started(count: int, start: Callable[..., BaseProcess]) -> tuple[float, float]:
    """Return how long workers take to be ready [s], and their memory with any server's [MB].

    The memory is not a number where /proc does not tell it.
    """
    began, pipes, workers = time.perf_counter(), [], []
    for _ in range(count):
        ours, theirs = subprocesses.CONTEXT.Pipe()
        workers.append(start(executors._work, theirs))
        theirs.close()
        pipes.append(ours)
    assert [pipe.recv() for pipe in pipes] == [None] * count
    taken, memory = time.perf_counter() - began, nan
    if sys.platform == "linux":
        pids = {worker.pid for worker in workers}
        memory = sum(map(_memory, pids | {*map(_parent, pids)} - {os.getpid()}))
    for pipe, worker in zip(pipes, workers, strict=True):
        pipe.close()
        worker.join()
    return taken, memory


def starting(workers: int = 4) -> None:
    """Print how soon workers are ready, next to processes that each load the whole league."""
    spawning = multiprocessing.get_context("spawn")

    def alone(target: Callable[..., None], pipe: Connection) -> BaseProcess:
        process = spawning.Process(target=target, args=(pipe,), daemon=True)
        process.start()
        return process

    each_s, each_mb = _started(workers, alone)
    subprocesses.prepare(executors.MODULES)
    first_s, _ = _started(1, subprocesses.start)
    served_s, served_mb = _started(workers, subprocesses.start)
    note(f"{workers} workers, all ready; the first of a server after {first_s:.2f} s:")
    figure("  each loads the league for itself", each_s, "s")
    figure("  forked off a server that has", served_s, "s")
    figure("  how much sooner", each_s / served_s, "x")
    figure("  memory of the first kind", each_mb, "MB")
    figure("  memory of the second, the server's too", served_mb, "MB")


def main() -> None:
    """Print the figures."""
    heading("The league's throughput")
    starting()
    drivers = policies([path for path in sys.argv[1:] if path.endswith(".pt")])
    if len(drivers) < 2:
        note("not measured: there is no camera policy in garage/, name one: FILE.pt")
        return
    note(f"The policies: {', '.join(one.card.name for one in drivers)}")
    with tempfile.TemporaryDirectory() as folder, league(Path(folder), drivers) as store:
        shares(store)
        batching(store)
        throughput(store, "bullet", 60.0, os.cpu_count() or 1, GOAL_A_DAY)
    note("The same policies under a planar ruleset:")
    with tempfile.TemporaryDirectory() as folder, league(Path(folder), drivers, "planar") as store:
        throughput(store, "planar", 30.0, os.cpu_count() or 1, GOAL_A_DAY_PLANAR)


if __name__ == "__main__":
    main()
