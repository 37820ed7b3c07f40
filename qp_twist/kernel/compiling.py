"""How the kernels are compiled, and kept on disk for exactly the sources that they were made from.

numba copies the code of a kernel into every kernel that calls it and optimises each copy. A kernel
that is compiled ``apart`` is referred to by its symbol instead, which halves the compilation time
of a step. A file lists the kernels that it calls so; they are loaded first.
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import importlib
import os
import pickle
import shutil
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite
import numba
import numpy as np
from llvmlite.binding import parse_assembly
from numba import njit, typeof
from numba.core import types
from numba.core.caching import CompileResultCacheImpl
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import PassManager
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps

try:
    import fcntl
except ImportError:  # not a POSIX system: every process compiles for itself
    fcntl = None  # type: ignore[assignment]

_REORDERED = {"reassoc", "contract", "nsz"}
"""Sums may be reordered and vectorised. NaN and infinity keep their meaning: comparisons rely on
them. But ``math.isfinite`` of a sum is true even for NaN: it subtracts the sum from itself."""
_RARELY = 1_000_000
"""Threshold of the garbage collector while compiling. numba allocates millions of objects that stay
alive; with Python's default of 700, a quarter of the compilation time is garbage collection."""
_LONGEST, _POLL = 300.0, 0.05
"""s. A process that has waited longer compiles for itself: the other may be suspended."""
_SOURCES = Path(__file__).resolve().parent


def _state_of_sources() -> str:
    """Hash of the names and contents of all sources in this folder, and of the compilers."""
    digest = hashlib.sha256(
        repr((numba.__version__, np.__version__, llvmlite.__version__)).encode()
    )
    for file in sorted(_SOURCES.glob("*.py")):
        digest.update(file.name.encode() + b"\0" + hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()[:16]


_AT_START = _state_of_sources()
_PYTHON = f"py{sys.version_info[0]}{sys.version_info[1]}{sys.abiflags}"


_Operator: Any = types.Function
_ask_templates = _Operator.get_call_type
_resolved: dict[Any, Any] = {}


def _resolve(function: Any, context: Any, arguments: Any, names: Any) -> Any:
    """The signature of an operator for types; numba asks dozens of templates for it at each use.

    Asking once takes a fifth less time to compile a step. Templates that are registered later make
    another ``function``.
    """
    key = function, tuple(arguments), tuple(names.items())
    if key not in _resolved:
        _resolved[key] = _ask_templates(function, context, arguments, names)
    return _resolved[key]


_UNUSED = {
    "WithLifting", "InlineClosureLikes", "MakeFunctionToJitFunction", "RewriteDynamicRaises",
    "InlineInlinables", "FindLiterallyCalls", "LiteralUnroll", "LiteralPropagationSubPipelinePass",
    "InlineOverloads",
}  # fmt: skip
"""Passes of numba's compiler for what kernels do not have: ``with``, closures, exceptions, literal
arguments, and functions to inline in Python. By their names: another version may lack some."""
_OF_ARRAYS = {"NopythonRewrites"}
"""The pass for expressions of whole arrays, whose results are allocated."""


class _Passes(CompilerBase):
    """numba's compiler without the passes that a kernel has no use for: a tenth of its time."""

    def define_pipelines(self) -> list[Any]:
        unused = _UNUSED if self.state.flags.nrt else _UNUSED | _OF_ARRAYS
        usual = DefaultPassBuilder.define_nopython_pipeline(self.state)
        needed: Any = PassManager(usual.pipeline_name)
        needed.passes = [each for each in usual.passes if each[0].__name__ not in unused]
        needed.finalize()
        return [needed]


class _Call(NamedTuple):
    """A reference to a kernel that is compiled ``apart``."""

    module: str
    name: str
    arguments: tuple[Any, ...]
    symbol: str
    """Symbol of its machine code; differs in each process that compiles it."""

    def is_there(self) -> bool:
        """Load or compile it; return whether its machine code has this symbol."""
        kernel_ = getattr(importlib.import_module(self.module), self.name)
        kernel_.compile(self.arguments)
        return bool(kernel_.overloads[self.arguments].fndesc.mangled_name == self.symbol)


class _Turn:
    """The lock on a folder while a process compiles; its end releases it, too."""

    depth, file = 0, -1

    @classmethod
    def take(cls, folder: Path) -> bool:
        """Take the lock, unless it is held; return whether another process had it before."""
        if fcntl is None or cls.file >= 0:
            return False
        waited = False
        with contextlib.suppress(OSError):  # nothing can be written, or there are no locks
            folder.mkdir(exist_ok=True)
            cls.file = os.open(folder / "lock", os.O_RDWR | os.O_CREAT, 0o600)
            for _ in range(int(_LONGEST / _POLL)):
                try:
                    fcntl.flock(cls.file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except BlockingIOError:
                    waited = True
                    time.sleep(_POLL)
        return waited

    @classmethod
    @contextlib.contextmanager
    def compiling(cls) -> Iterator[None]:
        """One kernel, during which those that it calls are compiled."""
        usual = gc.get_threshold()
        gc.set_threshold(max(usual[0], _RARELY) if usual[0] else 0, *usual[1:])
        cls.depth += 1
        _Operator.get_call_type = _resolve
        try:
            yield
        finally:
            cls.depth -= 1
            gc.set_threshold(*usual)
            if cls.depth == 0:
                _Operator.get_call_type = _ask_templates
            if cls.depth == 0 and cls.file >= 0:
                os.close(cls.file)
                cls.file = -1


@cache
def _processor(codegen: Any) -> Any:
    """What machine code depends on besides its sources; LLVM looks at the processor every time."""
    return codegen.magic_tuple()


@cache
def _is_own(file: str) -> bool:
    """Whether it is one of the sources whose state is known."""
    source = Path(file).resolve()
    return source.parent == _SOURCES and source.exists()


class _Kept:
    """The machine code of one kernel, a file for each signature; in the place of numba's cache.

    numba looks only at a function's own file, but a kernel contains the code of others. Here all
    code lies in a folder below numba's that is named by the hash of all sources; saving deletes
    those of other sources. A damaged file is compiled again; where nothing can be written, every
    process compiles.
    """

    _of_all: Any = None
    """numba's cache of the first kernel: of it only the folder counts, which all have."""

    def __init__(self, function: Any, *, apart: bool) -> None:
        self._apart, self.cache_path = apart, ""
        self._of = f"{function.__module__}.{function.__name__}"
        self._numba: Any = None
        own = _is_own(function.__code__.co_filename)
        with contextlib.suppress(RuntimeError):  # no folder can be written to
            if own and _Kept._of_all is None:
                _Kept._of_all = CompileResultCacheImpl(function)
            self._numba = _Kept._of_all if own else None
            self.cache_path = self._numba.locator.get_cache_path() if own else ""
        self._folder = Path(self.cache_path) / f"kernels-{_AT_START}.{_PYTHON}"

    def _file(self, signature: Any, codegen: Any) -> Path:
        key = hashlib.sha256(repr((signature, _processor(codegen))).encode()).hexdigest()[:16]
        return self._folder / f"{self._of.rpartition('kernel.')[2]}.{key}.nbc"

    def _calls(self, result: Any, others: tuple[_Call, ...]) -> tuple[_Call, ...]:
        """What a caller of this kernel refers to."""
        module, _, name = self._of.rpartition(".")
        itself = _Call(module, name, tuple(result.signature.args), result.fndesc.mangled_name)
        return (itself,) if self._apart else others

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Load machine code, after another process that compiles; ``None`` for none."""
        if self._numba is None:
            return None
        # All that loading needs of numba's state, which takes a sixth of a second to set up;
        # compiling sets it up itself.
        rtsys.initialize(context)
        file = self._file(signature, context.codegen())
        found = self._read(file, context)
        if found is None and _Turn.take(self._folder):
            found = self._read(file, context)
        return found

    def _read(self, file: Path, context: Any) -> Any:
        try:
            content = file.read_bytes()
        except OSError:
            return None
        if hashlib.sha256(content[32:]).digest() != content[:32]:
            return None
        calls, kept = pickle.loads(content[32:])
        # Machine code with an unresolved call would end the process.
        if not all(call.is_there() for call in calls):
            return None
        found = self._numba.rebuild(context, kept)
        found.library.kernel_calls = self._calls(found, calls)
        return found

    def save_overload(self, signature: Any, result: Any) -> None:
        """Save machine code, unless the sources were edited meanwhile or nothing can be written."""
        library = result.library
        linked = getattr(library, "_linking_libraries", ())
        calls = tuple(
            dict.fromkeys(c for made in linked for c in getattr(made, "kernel_calls", ()))
        )
        library.kernel_calls = self._calls(result, calls)
        if self._apart:
            library._shared_module = parse_assembly("")  # what is linked into its callers
        with contextlib.suppress(OSError):
            cachable = self._numba is not None and self._numba.check_cachable(result)
            if not cachable or _state_of_sources() != _AT_START:
                return
            data = dumps((calls, self._numba.reduce(result)))
            self._folder.mkdir(exist_ok=True)
            unfinished = self._folder / f"{uuid.uuid4().hex}.tmp"
            try:
                unfinished.write_bytes(hashlib.sha256(data).digest() + data)
                unfinished.replace(self._file(signature, result.library.codegen))
            finally:
                unfinished.unlink(missing_ok=True)
            for folder in self._folder.parent.glob(f"kernels-*.{_PYTHON}"):
                if folder != self._folder:
                    shutil.rmtree(folder, ignore_errors=True)


def _by_numba(*, apart: bool = False, **options: Any) -> Any:
    def compiled(function: Any) -> Any:
        settings: Any = {"error_model": "numpy", "nogil": True, "fastmath": _REORDERED} | options
        settings["pipeline_class"] = _Passes
        dispatcher: Any = njit(**settings)(function)
        dispatcher._cache = _Kept(function, apart=apart)
        compile_, template = dispatcher.compile, dispatcher.get_call_template

        def compiled_for(signature: Any) -> Any:
            with global_compiler_lock, _Turn.compiling():
                return compile_(signature)

        def called(arguments: Any, names: Any) -> Any:
            # One kernel for all constants, not one for 0 and one for 1.
            return template(tuple(map(types.unliteral, arguments)), names)

        dispatcher.compile, dispatcher.get_call_template = compiled_for, called
        return dispatcher

    return compiled


kernel: Any = _by_numba(_nrt=True)
"""Decorator of functions that allocate arrays."""
entry: Any = _by_numba(_nrt=False)
"""Decorator of functions that are called from Python and allocate no arrays."""
plain: Any = _by_numba(
    apart=True, _nrt=False, no_cpython_wrapper=True, no_cfunc_wrapper=True
)  # fmt: skip
"""Decorator of functions that only kernels call, each compiled once, ``apart``. They allocate no
arrays, so numba does not count references: for ten small arrays that takes longer than a matrix
product. They cannot be called from Python, which saves a third of the compilation time."""
inner: Any = _by_numba(apart=True, _nrt=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""The same of functions that allocate arrays."""
part: Any = _by_numba(
    _nrt=False, no_cpython_wrapper=True, no_cfunc_wrapper=True, forceinline=True
)  # fmt: skip
"""Decorator of functions that are inlined in every kernel that calls them: small ones called in
loops, and those with many arrays, each of which is five to nine arguments of a call."""


def bound(kernel_: Any, *arguments: Any) -> Callable[..., Any]:
    """The machine code of a kernel for arguments of these types.

    It does not look at the types again, which takes longer than the call: of two tuples of arrays
    0.7 instead of 8 µs. Arrays of another type would be read as if they had these.
    """
    signature = tuple(map(typeof, arguments))
    kernel_.compile(signature)
    code: Callable[..., Any] = kernel_.overloads[signature].entry_point
    return code
