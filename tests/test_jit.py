"""What is compiled: changes that its cache on disk must not miss, and where that cache is."""

import ast
import gc
import importlib
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys

import league
from league import jit, precompile
from league.errors import LeagueError
from tests import same_bits

PACKAGE = Path(league.__file__).parent
SOURCES = list(jit.sources())


def imports(path: str) -> list[tuple[str, str]]:
    """Return (module, name) of what a file imports from the package when it is loaded."""
    tree = ast.parse((PACKAGE / path).read_text(encoding="utf-8"))
    return [
        (str(node.module), alias.name)
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and str(node.module).split(".")[0] == "league"
        for alias in node.names
    ]


def digest_of(monkeypatch, package: Path) -> str:
    """Return the key of the cache of a package in this folder."""
    monkeypatch.setattr(jit, "__file__", str(package / "jit.py"))
    return jit.source_digest.__wrapped__()


@pytest.fixture(scope="module")
def copied(tmp_path_factory) -> Path:
    """A copy of the package's sources."""
    package = tmp_path_factory.mktemp("copy") / "league"
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__", "_*s"))
    return package


def test_every_file_that_uses_numba_is_part_of_the_key():
    users = {
        path.relative_to(PACKAGE).as_posix()
        for path in PACKAGE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Import | ast.ImportFrom)
        and re.search(r"\bnumba\b|league\.jit", ast.unparse(node))
        # What is compiled for a GPU is not kept.
        and not ast.unparse(node).startswith("from numba import cuda")
    }
    assert "sim/physics/planar.py" in users
    assert users <= set(SOURCES)


@pytest.mark.parametrize("path", SOURCES)
def test_compiled_code_takes_numbers_only_from_files_of_the_key(path):
    for module, name in imports(path):
        source = module.removeprefix("league.").replace(".", "/") + ".py"
        value = getattr(importlib.import_module(module), name)
        if source in SOURCES:
            continue
        if isinstance(value, type(ast)):
            assert f"{source[:-3]}/{name}.py" in SOURCES, (module, name)
        assert not isinstance(value, int | float | tuple | np.ndarray | np.generic), (module, name)


@pytest.mark.parametrize("path", SOURCES)
def test_key_changes_with_every_compiled_file(monkeypatch, copied, path):
    before, content = digest_of(monkeypatch, copied), (copied / path).read_bytes()
    (copied / path).write_bytes(content + b"\n")
    changed = digest_of(monkeypatch, copied)
    (copied / path).write_bytes(content)
    assert changed != before == digest_of(monkeypatch, copied)


def test_key_is_that_of_the_package_and_does_not_change_with_what_is_not_compiled(
    monkeypatch, copied
):
    (copied / "errors.py").write_bytes((copied / "errors.py").read_bytes() + b"\n")
    assert digest_of(monkeypatch, copied) == jit.source_digest()


GAP = """
import json, numpy as np
from league import jit
from league.track import projection
course = np.zeros(1, projection.COURSE)
course["length"], course["closed"] = 12.0, True
ahead, behind = np.float32([12.5]), np.float32([-0.5])  # so far apart that it wraps
gap = projection.gaps(course, np.zeros(1, np.int64), ahead, behind).item()
loaded = sum(projection.gaps.stats.cache_hits.values())
print(json.dumps([gap, loaded, str(jit.cache_folder())]))
"""


class Installation:
    """A part of the package in a folder of its own, with its caches in `home`."""

    def __init__(self, folder: Path) -> None:
        self.package, self.home = folder / "league", folder / "home"
        for name in ("__init__.py", "jit.py", "portable_math.py", "track/__init__.py"):
            self._take(name)
        self._take("track/projection.py")

    def _take(self, name: str) -> None:
        (self.package / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(PACKAGE / name, self.package / name)

    def make_read_only(self) -> None:
        """Put a file where the folder of machine code would be: it stops root too."""
        (self.package / "__pycache__").touch()

    def gap(self) -> tuple[float, int, str]:
        """Return a compiled function's result, how often it was loaded, and from which folder."""
        environment = {"PATH": os.environ["PATH"], "XDG_CACHE_HOME": str(self.home)}
        ran = subprocess.run(
            [sys.executable, "-B", "-c", GAP],
            cwd=self.package.parent,
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        return json.loads(ran.stdout)


def test_machine_code_is_kept_and_made_again_when_a_helper_elsewhere_changes(tmp_path):
    here = Installation(tmp_path)
    gap, loaded, folder = here.gap()
    assert (gap, loaded) == (1.0, 0)
    assert Path(folder).parent == here.package / "__pycache__"
    assert here.gap() == [1.0, 1, folder]
    source = here.package / "portable_math.py"
    text = source.read_text(encoding="utf-8")
    changed = text.replace(
        "value = _ZERO\n    return value", "value = _ZERO\n    return value + _ONE"
    )
    assert changed != text
    source.write_text(changed, encoding="utf-8")
    gap, loaded, other = here.gap()
    assert (gap, loaded) == (2.0, 0)
    assert other != folder
    assert not here.home.exists()


def test_machine_code_that_a_program_uses_counts_as_used_today(monkeypatch, tmp_path):
    monkeypatch.setattr(jit, "__file__", str(tmp_path / "jit.py"))
    folder = jit.cache_folder.__wrapped__()
    assert folder.is_relative_to(tmp_path)
    os.utime(folder, (0, 0))
    assert jit.cache_folder.__wrapped__() == folder
    precompile._remove_older(folder.with_name("jit-newer"))
    assert folder.exists()


def test_read_only_installation_compiles_into_the_users_cache(tmp_path):
    here = Installation(tmp_path)
    here.make_read_only()
    gap, loaded, folder = here.gap()
    assert (gap, loaded) == (1.0, 0)
    assert Path(folder).parent == here.home / "racing-league"
    assert list(Path(folder).glob("projection.gaps*.nbc"))
    assert here.gap() == [1.0, 1, folder]


def test_without_a_folder_to_write_to_it_compiles_all_the_same(tmp_path):
    here = Installation(tmp_path)
    here.make_read_only()
    here.home.touch()
    assert here.gap() == [1.0, 0, "None"]


def test_worlds_of_any_size_meet_the_code_that_is_compiled_already(race_env):
    from league.envs import step
    from league.sim.config import ObstacleConfig, SimConfig

    boxes = SimConfig(kind="obstacle_avoidance", obstacles=ObstacleConfig(count=2))
    placed = ObstacleConfig(count=1, kind="bot", places=((0.5, 1.0),))
    bots = SimConfig(kind="obstacle_avoidance", obstacles=placed)
    known = None
    for sim, num_worlds, mode in (
        (SimConfig(), 1, "race"),
        (SimConfig(kind="head_to_head", num_cars=3), 5, "training"),
        (boxes, 1, "training"),
        (bots, 2, "race"),
    ):
        env = race_env(sim=sim, num_worlds=num_worlds, mode=mode)
        env.reset()
        env.step(np.zeros((num_worlds, sim.num_cars, 2)))
        signatures = [*step.step.signatures, *step.reset.signatures]
        known = known or signatures
        assert signatures == known


def test_pictures_of_any_kind_meet_the_code_that_is_compiled_already(race_env):
    from league.sim.camera import painting, scene_state
    from league.sim.camera.renderer import Renderer
    from league.sim.config import CameraConfig, ObstacleConfig, SimConfig, VisualRandomization
    from league.video.stills import chase_view

    boxes = SimConfig(kind="obstacle_avoidance", obstacles=ObstacleConfig(count=2))
    pack, stereo = SimConfig(kind="head_to_head", num_cars=3), CameraConfig(width=16, height=12)
    known = None
    for sim, camera, looks in (
        (pack, stereo, None),
        (boxes, CameraConfig(width=16, height=12, colour=True, eyes="mono", up=1), None),
        (pack, stereo, VisualRandomization(colour=0.5, noise=2.0)),
    ):
        env = race_env(sim=sim, num_worlds=3)
        world = env.world.copy()
        world.cars.setflags(write=False)
        renderer = Renderer(env.tracks, sim, camera, looks)
        for rows in (None, np.array([2, 0])):
            renderer.render(world, 0, rows)
        chase_view(env.tracks, sim, world, 1, 0, 64, 36)
        signatures = [*painting.paint.signatures, *scene_state.stand.signatures]
        known = known or signatures
        assert signatures == known and len(known) == 2


def compiled_in_advance(tmp_path: Path) -> set[str]:
    """Return which functions `python -m league.precompile` has compiled, as file.function.

    `make sync` has run it for this installation; what was compiled later is younger than its mark.
    Without the mark a copy of the package is compiled.
    """
    folder = jit.cache_folder()
    if folder is None or not (folder / "complete").exists():
        package = tmp_path / "league"
        shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copytree(PACKAGE.parent / "tracks", tmp_path / "tracks")
        subprocess.run([sys.executable, "-m", "league.precompile"], cwd=tmp_path, check=True)
        (folder,) = (package / "__pycache__").glob("jit-*")
    made_s = (folder / "complete").stat().st_mtime
    code = [path for path in folder.glob("*.nbc") if path.stat().st_mtime <= made_s]
    return {path.name.split("-")[0] for path in code}


def test_arrays_that_compiled_functions_make_are_freed():
    def live_arrays() -> int:
        for name in (*same_bits.races(), *same_bits.contests()):
            steps = same_bits.raced if name in same_bits.races() else same_bits.contested
            for _ in zip(range(40), steps(name), strict=False):
                pass
        gc.collect()
        stats = rtsys.get_allocation_stats()
        return stats.alloc - stats.free

    _nrt_python.memsys_enable_stats()
    # Functions without reference counts, see `jit.compiled`, would keep arrays that others return.
    assert live_arrays() == live_arrays()


def test_functions_that_only_compiled_ones_call_have_no_machine_code_of_their_own():
    @jit.inner
    def doubled(number):
        return number + number

    @jit.inner
    def raised(number):
        return doubled(number) + 1

    def entry(number):
        return raised(number) * doubled(number)

    called = jit.njit(entry)
    assert called(3) == 42
    engine = next(iter(called.overloads.values())).library._codegen._engine
    for part, ours in ((doubled, False), (raised, False), (called, True)):
        (found,) = part.overloads.values()
        assert found.library._finalized
        loaded = engine.is_symbol_defined(found.fndesc.llvm_func_name)
        assert loaded is ours, part.__name__


@pytest.mark.parametrize("wanted", [True, False])
def test_loops_are_vectorised_unless_a_function_says_not_to(monkeypatch, wanted):
    monkeypatch.setattr(jit, "cache_folder", lambda: None)

    def squared(values, out):
        for k in range(len(values)):
            out[k] = values[k] * values[k]

    function, out = jit.compiled(squared, vectorizes=wanted), np.zeros(9, np.float32)
    function(np.arange(9, dtype=np.float32), out)
    assert out.tolist() == [0, 1, 4, 9, 16, 25, 36, 49, 64]
    (code,) = function.inspect_llvm().values()
    assert ("x float>" in code) is wanted


@pytest.mark.slow
def test_everything_is_compiled_in_advance(tmp_path):
    wanted = {
        f"{path.stem}.{node.name}"
        for path in PACKAGE.rglob("*.py")
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.FunctionDef)
        and any(ast.unparse(mark).startswith("compiled") for mark in node.decorator_list)
    }
    assert len(wanted) > 20
    assert wanted <= compiled_in_advance(tmp_path)


def test_compiling_shows_its_progress_and_happens_once(monkeypatch, tmp_path, capsys):
    folder = tmp_path / "jit-0123"
    folder.mkdir()
    monkeypatch.setattr(jit, "cache_folder", lambda: folder)
    monkeypatch.setattr(precompile, "PARTS", {"places": precompile.PARTS["places"]})
    monkeypatch.setattr(precompile, "GROUPS", (("places",),))
    precompile.ensure()
    first, last = capsys.readouterr().err.splitlines()
    assert "0 of 1 parts" in first and "once for this installation: 1 of 1 parts" in last
    precompile.ensure()
    assert capsys.readouterr().err == ""


def test_dependencies_that_a_path_holds_are_found_when_compiling(monkeypatch, tmp_path):
    (tmp_path / "sitecustomize.py").write_text("print('found')\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert list(precompile._compiled(("places",))) == ["found", "places"]


def test_a_part_that_does_not_compile_is_an_error(monkeypatch, tmp_path):
    monkeypatch.setattr(jit, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(precompile, "GROUPS", (("no such part",),))
    with pytest.raises(
        LeagueError, match=r"compiling the simulator failed \(KeyError: .*reinstall"
    ):
        precompile.ensure()
    assert not list(tmp_path.iterdir())
