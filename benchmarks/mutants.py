"""How many small faults in the code the tests catch: mutation testing with Cosmic Ray.

A mutant is the code with one change: another comparison, another operator, a number one higher, a
loop that never runs. The tests of its part should fail. Run it with `make mutants`; it takes half
an hour. Parts are chosen for what a fault in them would spoil: races, ratings and results.

The compiled modules run as plain Python (benchmarks/plain_python.py). Tests that take longer than
a second that way are left out, and so are those that fail without a mutant; types in annotations,
decorators and changes that Python refuses to parse are no mutants.

A mutant of a function's body is put into the functions of a fork of one pytest session
(benchmarks/mutant_trials.py); another one, of a constant say, is imported by a session of its own.
`python -m benchmarks.mutants referee store` tries these parts alone. runs/mutants/ shows which test
caught which mutant as they come; what is there and has not changed is not tried again
(benchmarks/mutant_results.py).
"""

import ast
import difflib
import gc
import hashlib
import os
import random
import re
import shutil
import sys
import tempfile
from collections.abc import Generator, Iterable, Iterator
from contextlib import chdir, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch  # noqa: F401  # loaded once, for all forks

from benchmarks import mutant_trials as trials
from benchmarks.mutant_results import Results, name_of
from benchmarks.mutant_trials import Loop, first_failure, put, replacements
from benchmarks.report import figure, heading, note, table
from league.errors import LeagueError

ROOT = Path(__file__).parents[1]
SAMPLE = 40
"""Mutants of each part."""
SEED = 0
GOAL = 85.0
"""Share that should be caught [%]."""
LONGEST_S = 120
"""Wall time after which a test of a second counts as failed: the mutant does not end."""


@dataclass(frozen=True)
class Part:
    """Modules and the tests that should notice their faults."""

    modules: tuple[str, ...]
    """Files or folders of league/."""
    tests: tuple[str, ...]
    """Files of tests/."""
    plain: bool = True
    """Whether compiled functions run as plain Python."""
    compiled: tuple[str, ...] = ()
    """Tests that would take too long so; they try what is not compiled as it is."""


PARTS = {
    "referee": Part(
        ("sim/referee.py",), ("sim/test_referee.py", "sim/test_blame.py", "sim/test_pursuit.py")
    ),
    "blame": Part(("sim/blame.py",), ("sim/test_blame.py", "sim/test_referee.py")),
    "collision": Part(("sim/physics/collision.py",), ("sim/test_contact.py", "sim/test_planar.py")),
    "bullet": Part(
        ("sim/physics/bullet.py",), ("sim/test_bullet.py", "sim/test_bullet_bodies.py")
    ),
    "rewards": Part(
        ("envs/rewards.py",), ("envs/test_rewards.py",),
        compiled=("envs/test_racing_line_reward.py",),
    ),
    "observations": Part(
        ("envs/observations.py", "envs/sensor_suite.py"), ("envs/test_observations.py",),
        compiled=("envs/test_sensor_suite.py", "envs/test_sensor_history.py", "envs/test_truth.py"),
    ),
    "ratings": Part(
        ("matchmaking/ratings/fit.py", "matchmaking/ratings/systems.py",
         "matchmaking/ratings/pair_counts.py", "matchmaking/ratings/table.py"),
        ("matchmaking/test_ratings.py", "matchmaking/test_update.py"),
        plain=False,
    ),
    "store": Part(
        ("matchmaking/store",),
        ("matchmaking/test_store.py", "matchmaking/test_store_blobs.py",
         "matchmaking/test_store_disputes.py", "matchmaking/test_store_edges.py",
         "matchmaking/test_store_integrity.py", "matchmaking/test_submission.py",
         "matchmaking/test_store_keys.py", "matchmaking/test_store_reliability.py",
         "matchmaking/test_cups.py", "matchmaking/test_seasons.py", "matchmaking/test_tokens.py",
         "matchmaking/test_safety.py"),
        plain=False,
    ),
    "checkpoint": Part(
        ("agents/checkpoint.py", "agents/torch_archive.py"),
        ("agents/test_checkpoint.py", "agents/test_checkpoint_limits.py",
         "agents/test_hostile_checkpoints.py"),
        plain=False,
    ),
}  # fmt: skip
_PAIRS = (
    "Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "FloorDiv_Div", "Mod_FloorDiv", "Pow_Mul",
    "BitAnd_BitOr", "BitOr_BitAnd", "RShift_LShift", "LShift_RShift", "USub_UAdd", "Delete_Not",
    "Lt_LtE", "Lt_GtE", "LtE_Lt", "LtE_Gt", "Gt_GtE", "Gt_LtE", "GtE_Gt", "GtE_Lt", "Eq_NotEq",
    "NotEq_Eq", "Is_IsNot", "IsNot_Is", "In_NotIn", "NotIn_In",
)  # fmt: skip
"""Replaced operators. Others, as a shift of two floats, fail wherever they are reached."""
_OTHERS = (
    "AddNot", "ReplaceTrueWithFalse", "ReplaceFalseWithTrue", "ReplaceAndWithOr",
    "ReplaceOrWithAnd", "ReplaceBreakWithContinue", "ReplaceContinueWithBreak",
    "ExceptionReplacer", "NumberReplacer", "ZeroIterationForLoop",
)  # fmt: skip
WANTED = re.compile(rf"core/(Replace(\w+)Operator_({'|'.join(_PAIRS)})|{'|'.join(_OTHERS)})$")


Span = tuple[tuple[int, int], tuple[int, int]]
"""Where something begins and ends, each as (line, column)."""


def listed(field: Any) -> list[ast.AST]:
    """Return the nodes of a field of a node: none, one or several."""
    return field if isinstance(field, list) else [field] if field is not None else []


def spans_of(path: Path, *fields: str) -> list[Span]:
    """Return the spans of what stands in these fields of a file's syntax tree."""
    nodes: list[Any] = [
        one
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        for name in fields
        for one in listed(getattr(node, name, None))
    ]
    return [((n.lineno, n.col_offset), (n.end_lineno, n.end_col_offset)) for n in nodes]


def within(spans: list[Span], one: Any) -> bool:
    """Return whether a mutation begins in one of these spans of its file."""
    return any(first <= one.start_pos < last for first, last in spans)


def mutants(paths: list[Path]) -> list:
    """Return Cosmic Ray's mutations of these files, in the order of files and places."""
    from cosmic_ray.commands import init
    from cosmic_ray.work_db import WorkDB, use_db

    with use_db(":memory:", WorkDB.Mode.create) as session:
        init(paths, session, {})
        every = [item.mutations[0] for item in session.work_items]
    spans = {path: spans_of(path, "annotation", "returns") for path in paths}
    found = [
        one
        for one in every
        if WANTED.match(one.operator_name) and not within(spans[one.module_path], one)
    ]
    return sorted(
        found, key=lambda m: (str(m.module_path), m.start_pos, m.operator_name, m.occurrence)
    )


@contextmanager
def written(one: Any) -> Generator[tuple[str, str]]:
    """Have a mutation in its file; return the code before and with it."""
    import cosmic_ray.plugins
    from cosmic_ray.mutating import use_mutation

    operator = cosmic_ray.plugins.get_operator(one.operator_name)()
    with use_mutation(one.module_path, operator, one.occurrence) as codes:
        yield codes


def sampled(found: list, number: int) -> Iterator:
    """Return some mutations that Python can parse, drawn with the fixed seed; not of decorators."""
    drawn = found.copy()
    random.Random(SEED).shuffle(drawn)
    for one in drawn:
        if within(spans_of(one.module_path, "decorator_list"), one):
            continue
        try:
            with written(one) as (_, mutated):
                compile(mutated, "", "exec")
        # Cosmic Ray finds no name to replace in `except module.Error`.
        except (SyntaxError, AttributeError):
            continue
        yield one
        number -= 1
        if number == 0:
            return


def in_functions(tried: list, results: Results, survivors: bool, session: pytest.Session) -> None:
    """Try the mutants that change only bodies of functions, in forks of one session.

    Args:
        tried: the mutants.
        results: of them.
        survivors: keep those that are not caught as well.
        session: with the tests.
    """
    failure = first_failure(session.items, results.before, "")
    if failure is not None:
        raise LeagueError(f"without a mutant {failure} fails")
    functions = trials.live_functions([one.module_path for one in tried])
    # The collector of a fork would write to all objects, and so copy them.
    gc.freeze()
    for one in tried:
        with written(one) as (source, mutated):
            changed = replacements(functions, one.module_path, source, mutated)
            if changed is not None:
                known = results.before | results.all()
                put_in = partial(put, changed)
                failure = first_failure(session.items, known, name_of(one), put_in)
                if failure or survivors:
                    results.add(one, failure)


def at_import(one: Any, options: list[str], results: Results) -> None:
    """Try a mutant in a session of its own."""

    def work(session: pytest.Session) -> None:
        known = results.before | results.all()
        results.add(one, first_failure(session.items, known, name_of(one)))

    with written(one):
        trials.session(options, Loop(work))
    if name_of(one) not in results.all():
        results.add(one, trials.ENDED)


def try_all(name: str, part: Part, chosen: list, results: Results) -> None:
    """Try the mutants of a part that have no result yet."""
    common = ["-p", "no:cacheprovider", "-p", "benchmarks.plain_python", "-k", "not postgresql"]
    common += ["-W", "ignore::RuntimeWarning", f"--timeout={LONGEST_S}", "--basetemp=temporary"]
    for tests, plain in (part.compiled, False), (part.tests, part.plain):
        if not tests:
            continue
        os.environ["MUTANTS_RECORD"] = str(Path.cwd() / f"{name}{int(plain)}.json")
        os.environ["NUMBA_DISABLE_JIT"] = str(int(plain))
        options = [*common, *(f"tests/{test}" for test in tests)]
        trials.session(options)
        work = partial(in_functions, results.left(chosen), results, tests is part.tests)
        status, printed = trials.session(options, Loop(work))
        if status:
            raise LeagueError(f"the trials of {name} ended early:\n{printed}")
    for one in results.left(chosen):
        at_import(one, options, results)


def digest_of(paths: list[Path]) -> str:
    """Return a hash of files."""
    digest = hashlib.sha256()
    for path in paths:
        digest.update(path.read_bytes())
    return digest.hexdigest()


def tested(name: str, part: Part) -> tuple[int, int, int]:
    """Return how many mutants a part has, how many were tried, and how many were caught.

    The working folder is a copy of the repository; each mutant is written into it and taken back.
    """
    given = [Path("league", module) for module in part.modules]
    paths = [
        path for one in given for path in (sorted(one.glob("*.py")) if one.is_dir() else [one])
    ]
    tests = [Path("tests", test) for test in (*part.tests, *part.compiled)]
    tests.append(Path("benchmarks/plain_python.py"))  # it decides which of them are fast and sound
    found = mutants(paths)
    chosen = list(sampled(found, SAMPLE))
    kept = ROOT / "runs" / "mutants" / f"{name}.json"
    results = Results(kept, digest_of(paths), digest_of(tests))
    if results.left(chosen):
        try_all(name, part, chosen, results)
    caught_by = results.all()
    survivors = [one for one in chosen if caught_by[name_of(one)] is None]
    for one in survivors:
        with written(one) as codes:
            lines = difflib.ndiff(*(code.splitlines() for code in codes))
            changed = [line for line in lines if line[:1] in "+-"]
            print(f"survived: {name_of(one)}", *changed, sep="\n  ", flush=True)
    return len(found), len(chosen), len(chosen) - len(survivors)


@contextmanager
def copied() -> Generator[None]:
    """Have a copy of the repository as the working folder, from which children import."""
    environment = dict(os.environ)
    with tempfile.TemporaryDirectory() as folder:
        for name in ("league", "tests", "tracks", "garage", "benchmarks", "examples", "docs"):
            left = shutil.ignore_patterns("*.pyc", "*.run")
            shutil.copytree(ROOT / name, Path(folder) / name, ignore=left)
        shutil.copy(ROOT / "pyproject.toml", folder)
        # Two mutants of one length within a second would share their bytecode.
        os.environ |= {"PYTHONPATH": folder, "PYTHONDONTWRITEBYTECODE": "1"}
        sys.dont_write_bytecode = True
        try:
            with chdir(folder):
                yield
        finally:
            os.environ.clear()
            os.environ.update(environment)


def main(names: Iterable[str] = tuple(PARTS)) -> None:
    """Print the share of mutants caught, part by part."""
    heading("Mutants caught by the tests")
    note(
        f"{SAMPLE} mutants of each part, drawn with seed {SEED}. Tests slower than a second "
        "without compilation are left out; a test that they would fail counts as none."
    )
    with copied():
        rows = [(name, *tested(name, PARTS[name])) for name in names]
    row = table("part", "mutants", "tried", "caught", "share")
    for name, number, tried, caught in rows:
        row(name, number, tried, caught, f"{100 * caught / tried:.0f} %")
    tried, caught = (sum(int(one[k]) for one in rows) for k in (2, 3))
    parts = f"{len(rows)} of {len(PARTS)} parts"
    figure(f"caught of {tried} sampled mutants, {parts}", 100 * caught / tried, "%", GOAL)


if __name__ == "__main__":
    main(sys.argv[1:] or PARTS)
