"""Numba as we use it: compiled functions, and the folder in which their machine code is kept.

Numba's own cache looks for changes in a function's own file alone, so a changed helper in another
file would go unnoticed. Here the cache is keyed by a hash of every compiled source of the package,
of the files that they take constants from, and of Numba's version: any change compiles everything
again, once.

Results are the same bits on every machine: no fast-math, so LLVM neither fuses a multiplication
with an addition nor reorders a sum.
"""

from __future__ import annotations

import hashlib
import os
import re
import tempfile
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numba
from numba.core import caching, config
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.runtime.nrt import rtsys

_Function = Callable[..., Any]
njit: Any = numba.njit
_MARK = b"from league.jit import"
# Machine code holds the value of a constant, whatever file it is from.
_CONSTANTS = re.compile(
    rb"^from league\.([\w.]+) import (?:\([^)]*?|[^(\n]*?)\b[A-Z][A-Z0-9_]+\b", re.MULTILINE
)


def sources() -> dict[str, bytes]:
    """Return the files that machine code is made from, by their paths within the package."""
    package = Path(__file__).parent
    files = {
        path.relative_to(package).as_posix(): path.read_bytes() for path in package.rglob("*.py")
    }
    found: set[str] = set()
    new = {name for name, content in files.items() if _MARK in content} | {Path(__file__).name}
    while new:
        found |= new
        rooms = [room.decode() for name in new for room in _CONSTANTS.findall(files[name])]
        new = {f"{room.replace('.', '/')}.py" for room in rooms} - found
    return {name: files[name] for name in sorted(found)}


@cache
def source_digest() -> str:
    """Return a hash of all compiled sources and of Numba's version."""
    digest = hashlib.sha256(numba.__version__.encode())
    for name, content in sources().items():
        digest.update(name.encode() + b"\0" + content)
    return digest.hexdigest()[:16]


@cache
def cache_folder() -> Path | None:
    """Return where machine code is kept, in the package or the user's cache; None: nowhere."""
    shared = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    for base in (Path(__file__).parent / "__pycache__", Path(shared) / "racing-league"):
        folder = base / f"jit-{source_digest()}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                os.utime(folder)  # In use: what was not for a day is removed (precompile.py).
                return folder
        except OSError:
            continue
    return None


class _Locator(caching._CacheLocator):  # pyright: ignore[reportPrivateUsage]
    """Tells Numba where machine code is kept and which sources it was made from."""

    def __init__(self, py_func: Callable[..., Any], py_file: str) -> None:
        self._line = py_func.__code__.co_firstlineno
        # The Numba of today also asks for the file's name to write messages.
        self._py_file = py_file

    def get_cache_path(self) -> str:  # pyright: ignore[reportIncompatibleMethodOverride]
        return str(cache_folder())

    def get_source_stamp(self) -> str:  # pyright: ignore[reportIncompatibleMethodOverride]
        return source_digest()

    def get_disambiguator(self) -> str:  # pyright: ignore[reportIncompatibleMethodOverride]
        return str(self._line)

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> _Locator:
        return cls(py_func, py_file)


class _CacheImpl(caching.CompileResultCacheImpl):
    _locator_classes = [_Locator]  # noqa: RUF012


class _Cache(caching.FunctionCache):
    _impl_class = _CacheImpl

    def load_overload(self, sig: object, target_context: Any) -> Any:  # noqa: ANN401
        """Load machine code without the half of Numba that only compiling needs.

        Numba's own method first refreshes the context, which takes a tenth of a second; a compiler
        does so itself where nothing is found.
        """
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)


class _PartLibrary(JITCodeLibrary):
    """The code of a function that only compiled functions call.

    It is linked into those that Python calls, and optimised and turned into machine code there.
    Numba's own library does both for each function at each level of the calls, for nothing.
    """

    @property
    def codegen(self) -> Any:  # noqa: ANN401
        return self  # Numba's compiler asks it to set_env, nothing else

    def set_env(self, name: str, env: object) -> None:
        """Set nothing: the variable is in machine code, of which there is none."""

    def get_pointer_to_function(self, name: str) -> int:
        """Return no address: Python calls no part."""
        self._ensure_finalized()
        return 0

    def _optimize_functions(self, ll_module: Any) -> None:  # noqa: ANN401
        """Simplify what a module defines; Numba also prepares to for all that it declares.

        Without this a step of the worlds takes 8 % longer, optimised as a whole or not.
        """
        codegen: Any = self._codegen
        ll_module.data_layout = codegen._data_layout
        for function in ll_module.functions:
            if not function.is_declaration:
                manager, builder = codegen._function_pass_manager()
                manager.run(function, builder)

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalized = True


class _ScalarLibrary(JITCodeLibrary):
    """Code in which LLVM leaves loops as they are; it is kept on disk."""

    def __init__(self, *arguments: Any) -> None:  # noqa: ANN401
        super().__init__(*arguments)
        self.enable_object_caching()

    def _optimize_final_module(self) -> None:
        options: Any = config
        usual, options.LOOP_VECTORIZE = options.LOOP_VECTORIZE, 0
        try:
            super()._optimize_final_module()
        finally:
            options.LOOP_VECTORIZE = usual


class _LibraryCompiler(Compiler):
    """Numba's compiler, with another library for the code of a function."""

    library: type[JITCodeLibrary]

    def define_pipelines(self) -> Any:  # noqa: ANN401
        state: Any = self.state
        state.library = self.library(state.targetctx.codegen(), state.func_id.func_qualname)
        return super().define_pipelines()


class _PartCompiler(_LibraryCompiler):
    library = _PartLibrary


class _ScalarCompiler(_LibraryCompiler):
    library = _ScalarLibrary


_ENTRY: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}
_INNER: dict[str, Any] = {**_ENTRY, "no_cpython_wrapper": True, "pipeline_class": _PartCompiler}


def compiled(
    function: _Function | None = None, *, allocates: bool = False, vectorizes: bool = True
) -> Any:  # noqa: ANN401
    """Compile a function that is called from Python; its machine code is kept on disk.

    It releases the interpreter, so that several threads may each work on worlds of their own.
    `allocates` says whether it makes or returns arrays: otherwise views of arrays have no reference
    counts, which cost more than the arithmetic of a short function. `vectorizes` says whether LLVM
    may work several rounds of a loop at a time: a loop over cars only becomes slower, because
    their records have to be gathered and scattered.
    """
    if function is None:
        return partial(compiled, allocates=allocates, vectorizes=vectorizes)
    options = _ENTRY if vectorizes else {**_ENTRY, "pipeline_class": _ScalarCompiler}
    dispatcher = njit(nogil=True, _nrt=allocates, **options)(function)
    if cache_folder() is not None:
        dispatcher._cache = _Cache(function)
    return dispatcher


def inner(function: _Function | None = None, *, allocates: bool = False) -> Any:  # noqa: ANN401
    """Compile a function that only compiled functions call; see `compiled`."""
    if function is None:
        return partial(inner, allocates=allocates)
    return njit(_nrt=allocates, **_INNER)(function)
