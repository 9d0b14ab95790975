"""Imports follow docs/architecture.md: none goes up, none in a circle, heavy packages stay put."""

import ast
import json
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

LEAGUE = Path(__file__).parents[1] / "league"
LAYERS = {
    "league": 1, "errors": 1, "atomic_file": 1, "flags": 1, "jit": 1, "portable_math": 1,
    "subprocesses": 1, "threads": 1, "times": 1,
    "figures": 2, "track": 2,
    "sim": 3,
    "race_spec": 4, "racing_line": 4,
    "envs": 5, "replay": 5,
    "agents": 6, "rerun_view": 6, "video": 6,
    "envs.adapters": 7, "deepracer": 7,
    "racing": 8,
    "training": 9,
    "matchmaking": 10,
    "precompile": 11, "web": 11,
    "cli": 12, "__main__": 12,
}  # fmt: skip
HEAVY = {
    "rerun": ("rerun_view",),
    "pybullet": ("sim.physics.bullet",),
    "numba": (
        "jit",
        "envs.adapters.gpu_camera",
        "sim.camera.painting",
        "sim.camera.raster",
        "video.pixels",
    ),
    "pettingzoo": ("envs.adapters.parallel_env",),
    "rsl_rl": ("envs.adapters.rsl_vec_env", "training"),
    "stable_baselines3": ("envs.adapters.sb3_vec_env",),
    "shapely": (),
    "tensordict": ("envs.adapters.rsl_vec_env", "training"),
    "gymnasium": ("envs",),
    "av": ("video",),
    "ray": ("matchmaking.workers",),
    "safetensors": ("matchmaking.submission",),
    "matplotlib": ("figures", "deepracer.rescore", "training"),
    "sqlite3": ("matchmaking.store",),
    "sqlalchemy": ("matchmaking.store",),
    "alembic": ("matchmaking.store",),
    "psycopg": ("matchmaking.store",),
    "starlette": ("web",),
    "jinja2": ("web",),
    "uvicorn": ("web",),
    "fsspec": ("matchmaking.store.blobs",),
}
LOADED_LATE = (
    "torch",
    "numba",
    "rerun",
    "pybullet",
    "pettingzoo",
    "gymnasium",
    "rsl_rl",
    "cv2",
    "scipy",
    "av",
    "starlette",
    "uvicorn",
    "jinja2",
)


@cache
def modules() -> dict[str, ast.Module]:
    """Return the tree of every module, by its name without `league.`."""
    found = {}
    for path in sorted(LEAGUE.rglob("*.py")):
        parts = path.relative_to(LEAGUE).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts) or "league"
        found[name] = ast.parse(path.read_text(encoding="utf-8"))
    return found


@cache
def imports(tree: ast.AST, *, late: bool = True) -> frozenset[str]:
    """Return the full names that a module imports; without `late` those it needs to be loaded."""
    found, nodes = set(), list(ast.iter_child_nodes(tree))
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are written in full"
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif late or not _is_late(node):
            nodes += ast.iter_child_nodes(node)
    return frozenset(found)


def _is_late(node: ast.AST) -> bool:
    typing_only = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
    return typing_only or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)


def arrows(*, late: bool = True) -> set[tuple[str, str]]:
    """Return (module, module it imports) within the league."""
    known = modules()
    found = set()
    for name, tree in known.items():
        for target in imports(tree, late=late):
            if target.split(".")[0] != "league":
                continue
            parts = target.split(".")[1:]
            while parts and ".".join(parts) not in known:
                parts = parts[:-1]  # a function or class of a module
            found.add((name, ".".join(parts) or "league"))
    return found


def package_of(name: str) -> str:
    """Return the part with a layer that a module is in; adapters load drivers by name."""
    # `league.envs` itself only re-exports the adapters.
    is_adapter = name == "envs" or f"{name}.".startswith("envs.adapters.")
    return "envs.adapters" if is_adapter else name.split(".")[0]


def upward(found: set[tuple[str, str]]) -> list[str]:
    packages = [(package_of(one), package_of(other), one, other) for one, other in found]
    return sorted(f"{a} -> {b}" for x, y, a, b in packages if LAYERS[y] > LAYERS[x])


def circle(found: set[tuple[str, str]]) -> list[str]:
    """Return the modules that remain when those that import nothing left are taken away."""
    left = {(a, b) for a, b in found if a != b}
    while True:
        free = {b for _, b in left} - {a for a, _ in left}
        fewer = {(a, b) for a, b in left if b not in free}
        if fewer == left:
            return sorted({a for a, _ in left})
        left = fewer


def test_every_module_has_a_layer():
    assert {package_of(name) for name in modules()} <= LAYERS.keys()


def test_the_page_of_the_architecture_has_these_layers():
    page = (LEAGUE.parent / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d+) \| (.*?) \|", page, re.MULTILINE)
    drawn = {name: int(layer) for layer, cell in rows for name in re.findall(r"`([\w.]+)/?`", cell)}
    unlisted = {"league", "__main__"}
    assert {name: drawn.get(name) for name in LAYERS.keys() - unlisted} == {
        name: layer for name, layer in LAYERS.items() if name not in unlisted
    }


def test_no_arrow_points_up():
    assert upward(arrows()) == []


def test_nothing_imports_in_a_circle():
    assert circle(arrows(late=False)) == []


def test_no_package_imports_in_a_circle_not_even_late():
    packages = {(package_of(one), package_of(other)) for one, other in arrows()}
    assert circle({(a, b) for a, b in packages if "league" not in (a, b)}) == []


@pytest.mark.parametrize("package", HEAVY)
def test_heavy_package_is_imported_only_where_it_belongs(package):
    met = {
        name
        for name, tree in modules().items()
        if any(target.split(".")[0] == package for target in imports(tree))
    }
    own = HEAVY[package]
    assert {name for name in met if not f"{name}.".startswith(tuple(f"{o}." for o in own))} == set()


HELP = """
import contextlib, io, league.cli
with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
    league.cli.main(["--help"])
"""


@pytest.mark.parametrize("program", ["import league", HELP], ids=["import", "help"])
def test_first_steps_load_none_of_the_heavy_packages(program):
    program += "\nimport json, sys; print(json.dumps(sorted(sys.modules)))"
    command = [sys.executable, "-c", program]
    ran = subprocess.run(command, capture_output=True, text=True, check=True)
    assert set(json.loads(ran.stdout)) & set(LOADED_LATE) == set()


def test_guard_sees_a_forbidden_arrow_and_a_circle():
    late = ast.parse("def f():\n    from league.envs.race_env import RaceEnv")
    assert imports(late) == {"league.envs.race_env.RaceEnv"}
    assert imports(late, late=False) == set()
    assert upward({("sim.grid", "envs.race_env"), ("envs.race_env", "sim.grid")}) == [
        "sim.grid -> envs.race_env"
    ]
    assert circle({("a", "b"), ("b", "c"), ("c", "b"), ("c", "d")}) == ["a", "b", "c"]


def test_no_module_imports_what_it_needs_from_tests():
    # What several tests need lies in modules of its own, as CONTRIBUTING.md asks.
    found = [
        f"{path.name}: {node.module}"
        for path in (LEAGUE.parent / "tests").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and re.match(r"tests\.(\w+\.)*test_", node.module or "")
    ]
    assert found == []
