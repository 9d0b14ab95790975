"""The same races and decisions give the same bits, whatever processor the code is compiled for."""

from __future__ import annotations

import hashlib
import importlib
import json
import os
import platform
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

from league import jit, precompile
from league.racing import race
from tests import same_bits

RECORDED = {
    "bots": "b9b1aaa07903f5c3",
    "boxes": "6a37e0ddcadea74d",
    "crowd": "5012b75e6d93271e",
    "meeting": "f5b78a4b166e30f2",
    "policies": "d82bfcbb68d0f598",
    "policy": "721d124fbadbb943",
    "race": "f0970a467f4b4893",
    "scripted_bullet": "c5f8a01b3a162569",
    "scripted_planar": "9ca7cd742e2db6ac",
}
"""SHA-256 over the hashes of all fields of a race, in the order of their names, shortened.

A change that is meant to alter races replaces them by what the failing test prints.
"""
BEFORE = {"bots": "5c797b4a13d9449f", "race": "43e07c0a6cabdcba"}
"""The same of the version before rules had names, under the rules of that time, but for pictures:
its cameras stayed level."""
ADDED = (
    "touches", "pushed_by", "pushed_steps", "pushed_speed", "pace", "closing_speed", "touched",
    "forced_off", "pushed_off", "verdicts penalty_s", "top_speed", "to_blame", "near", "attack",
)  # fmt: skip
"""Fields that it did not have."""
LEVEL = ("cars roll", "cars pitch")
"""Fields that were 0 in the planar solver then: its cars did not lean."""
REMOVED = "cars parked"
"""A field that it had, which was False in races."""
IS_X86 = platform.machine() == "x86_64"
X86 = pytest.mark.skipif(not IS_X86, reason="features of x86-64")
ALL = pytest.mark.skipif(
    "LEAGUE_ALL_PROCESSORS" not in os.environ,
    reason="takes 40 s to compile, and is near to the oldest processor: LEAGUE_ALL_PROCESSORS=1",
)
LIBRARIES = {
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
    "OPENBLAS_CORETYPE": "Nehalem",
    "OPENCV_CPU_DISABLE": "AVX512-SKX,AVX2,FMA3,AVX,SSE4.2",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F,-AVX2,-AVX,-FMA,-FMA4",
}
"""Libraries of x86-64 without their vector code."""
# Of x86-64 "generic" is the oldest processor, without SSE3, and libraries work as on one, too.
OLDER = {"NUMBA_CPU_NAME": "generic", **(LIBRARIES if IS_X86 else {})}
FLAGS = re.compile(r"\b(fast|contract|reassoc|arcp|afn|nnan|ninf|nsz)\b|llvm\.(fma|fmuladd)\b")
FUSED = re.compile(r"\bvfn?m(add|sub)|\bfn?m(add|sub)\b|\bfml[as]\b")  # of x86-64 and ARM64
PRODUCTS = {"_decide": 100, "_drive": 250, "paint": 200, "reset": 150, "step": 600}
"""Products that the largest functions have at least: they are what is inspected, with all that
they call."""


def entries() -> dict[str, Dispatcher]:
    """Return all compiled functions that Python calls, by their names."""
    found = {}
    for path in jit.sources():
        room = importlib.import_module(f"league.{path.removesuffix('.py').replace('/', '.')}")
        for name, entry in vars(room).items():
            # Those that only compiled functions call do not release the interpreter.
            released = isinstance(entry, Dispatcher) and entry.targetoptions.get("nogil")
            if released and entry.py_func.__module__ == room.__name__:
                found[f"{room.__name__}.{name}"] = entry
    return found


ENTRIES = entries()


@cache
def here() -> dict[str, str]:
    return same_bits.digests()


def elsewhere(**environment: str) -> tuple[list[str], dict[str, str]]:
    """Return what another process compiled for, and the hash of each field there."""
    root = Path(__file__).parents[1]
    run = subprocess.run(
        [sys.executable, str(root / "tests" / "same_bits.py")],
        env={**os.environ, "PYTHONPATH": str(root), "OMP_NUM_THREADS": "1", **environment},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        cwd=root,
    )
    printed = json.loads(run.stdout.splitlines()[-1])
    return printed["target"], printed["digests"]


def differing(found: dict[str, str]) -> list[str]:
    assert found.keys() == here().keys()
    return [field for field, seen in found.items() if seen != here()[field]]


def test_races_and_decisions_are_the_recorded_ones_to_the_last_bit():
    assert same_bits.by_race(here()) == RECORDED


@pytest.mark.parametrize("name", BEFORE)
def test_under_the_originals_rules_races_are_what_they_were(name):
    found: dict[str, hashlib._Hash] = {}
    for field, numbers in same_bits.raced(name, same_bits.ORIGINAL):
        if not field.endswith((*ADDED, "stereo")):
            then = np.zeros_like(numbers) if field.endswith(LEVEL) else numbers
            found.setdefault(field, hashlib.sha256()).update(then.tobytes())
        if field.endswith("cars ghost"):
            parked = found.setdefault(f"{name} {REMOVED}", hashlib.sha256())
            parked.update(np.zeros_like(numbers).tobytes())
    whole = hashlib.sha256()
    for _, seen in sorted(found.items()):
        whole.update(seen.hexdigest().encode())
    assert whole.hexdigest()[:16] == BEFORE[name]


def test_races_meet_what_may_differ():
    """Contacts, walls, penalties, laps and passes occur, so the bits above went through them."""
    for name, expected in {
        "race": ("crashed", "off_track", "released", "lap", "finished", "overtook", "wall"),
        "boxes": ("crashed", "off_track", "released"),
        "bots": ("crashed", "off_track", "released"),
        "meeting": ("crashed", "off_track", "overtook"),
        "crowd": ("crashed", "off_track", "released", "overtook"),
    }.items():
        seen = [env._verdicts.copy() for env in same_bits.drive(*same_bits.races()[name])]
        for field in expected:
            assert np.any(np.stack(seen)[field]), f"{name} {field}"


@pytest.mark.parametrize("name", ["scripted_bullet", "scripted_planar"])
def test_races_of_drivers_pass_and_hit_each_other(name):
    finished = race.run(same_bits.contests()[name], record=False)
    kinds = {event.kind for event in finished.result.events}
    assert {"overtake", "finish"} <= kinds
    assert name != "scripted_bullet" or {"contact", "crash"} <= kinds


@pytest.mark.parametrize("threads", ["1", "3", "7"])
def test_bits_do_not_depend_on_the_number_of_threads(monkeypatch, threads):
    monkeypatch.setenv("OMP_NUM_THREADS", threads)
    found: dict[str, hashlib._Hash] = {}
    for field, numbers in same_bits.raced("crowd"):
        found.setdefault(field, hashlib.sha256()).update(numbers.tobytes())
    assert {field: seen.hexdigest() for field, seen in found.items()} == {
        field: seen for field, seen in here().items() if field.startswith("crowd")
    }


def test_bits_do_not_depend_on_the_processor_compiled_for():
    # The first run on a machine compiles; the machine code is then kept next to that of its own.
    target, found = elsewhere(**OLDER)
    assert target == ["generic", ""]
    assert differing(found) == []


@pytest.mark.slow
@X86
@pytest.mark.parametrize(
    "environment",
    [
        pytest.param({"NUMBA_CPU_FEATURES": "-avx,-avx2,-avx512f,-fma"}, marks=ALL),
        {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": "+avx,+avx2,+fma"},
        LIBRARIES,
    ],
    ids=["no AVX", "fused", "libraries"],
)
def test_bits_do_not_depend_on_processor_features(environment):
    if "+fma" in environment.get("NUMBA_CPU_FEATURES", ""):
        flags = Path("/proc/cpuinfo").read_text(encoding="utf-8").split()
        if not {"fma", "avx2"} <= set(flags):
            pytest.skip("this processor has no fused multiply-add")
    target, found = elsewhere(**environment)
    assert target[1] == environment.get("NUMBA_CPU_FEATURES", target[1])
    assert differing(found) == []


@cache
def code() -> list[tuple[str, str]]:
    """Return what precompile compiles, for LLVM and for the processor, a pair for each function.

    Numba's own inspection refuses to show code from its cache on disk.
    """
    for part in precompile.PARTS.values():
        part()
    libraries = [one.library for entry in ENTRIES.values() for one in entry.overloads.values()]
    modules = [(one.codegen, one._get_module_for_linking().clone()) for one in libraries]
    return [(str(module), codegen._tm.emit_assembly(module)) for codegen, module in modules]


@pytest.mark.slow
@pytest.mark.parametrize("name", ENTRIES)
def test_no_sum_is_fused_or_reordered(name):
    mangled = "_ZN" + "".join(f"{len(part)}{part}" for part in name.split("."))
    # Its own code, or that of the functions that call it.
    found = [pair for pair in code() if mangled in pair[0]]
    assert found, "no part of precompile calls it"
    for intermediate, machine_code in found:
        # Processors differ in how many products one instruction makes.
        lanes = re.findall(r"= fmul (?:<(\d+) x )?", intermediate)
        products = sum(int(lane or 1) for lane in lanes)
        assert products >= PRODUCTS.get(name.rpartition(".")[2], 0)
        assert FLAGS.findall(intermediate) == []
        assert FUSED.findall(machine_code) == []


@pytest.mark.slow
@X86
def test_a_league_raced_on_an_older_processor_audits_clean_here(league, tmp_path):
    database = f"sqlite:///{tmp_path}/league.db"
    root = Path(__file__).parents[1]

    def here(*arguments: str) -> str:
        code, out, err = league(*arguments, "--league", database)
        assert code == 0, err
        return out

    here("init", "--solver", "planar", "--laps", "1", "--track", "peanut")
    for name in ("racer", "duelist"):
        here("submit", str(root / "garage" / f"{name}.pt"), "--owner", name)
    raced = subprocess.run(
        [sys.executable, "-m", "league.cli", "run", "--heats", "8", "--workers", "1"],
        env={**os.environ, **OLDER, "LEAGUE_URL": database},
        capture_output=True,
        text=True,
        check=True,
        cwd=root,
    )
    assert "8 heats" in raced.stdout
    audited = here("audit", "--sample", "100%", "--workers", "1")
    assert re.search(r"(\d+) heats were run again: \1 agree, 0 differ", audited), audited
