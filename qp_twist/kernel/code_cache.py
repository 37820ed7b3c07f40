"""Where the machine code of kernels is kept, and which sources it belongs to.

numba keeps the machine code of a function for as long as the function's own file stays as it is. A
kernel also contains the machine code of the kernels that it calls, most of them in other files, so
that an edit there, or an upgrade of the package, would go on running the code of before. So an
entry belongs to the contents of all files of this folder together. numba adds its own version, the
processor and the bytecode of the function; the versions of NumPy and llvmlite are added here.

The names of the files contain the key, so that processes which run different sources never read
each other's code. Whoever stores a kernel removes the same kernel's files of other sources: one
generation is kept for each version of Python, some 10 MB.

numba puts the code of a kernel into every kernel that calls it, and optimises it there again: at
the top of a chain of ten calls, everything ten times over. Most kernels here are too long to gain
by it. They stand ``apart``: their callers get their names alone, and the processor jumps. That
makes the time to compile a step half as long. An entry on disk then names the kernels that it
calls, and with which symbols; they are loaded first.
"""

from __future__ import annotations

import hashlib
import importlib
import sys
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite
import numpy as np
from llvmlite.binding import parse_assembly
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile

from qp_twist.kernel.compile_lock import CompileLock

_FOLDER = Path(__file__).resolve().parent


def _contents() -> str:
    """One hash of the names and contents of all files in this folder that kernels may lie in.

    Raises:
        RuntimeError: If there are none, as where a package is shipped without its sources.
    """
    files = sorted(_FOLDER.glob("*.py"))
    if not files:
        raise RuntimeError("the sources of the kernels are not there")
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.name.encode() + b"\0" + hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


_contents_at_start = cache(_contents)
"""The same as it was when the first kernel of this process was declared."""


class _Call(NamedTuple):
    """A kernel that stands apart, as its callers know it."""

    module: str
    name: str
    arguments: tuple[Any, ...]
    symbol: str
    """Of its machine code. It is another one in another process that compiles it anew."""


def _calls_of(library: Any) -> tuple[_Call, ...]:
    """What the machine code of a kernel jumps to, of what stands apart."""
    found = dict[_Call, None]()
    for linked in getattr(library, "_linking_libraries", ()):
        itself: _Call | None = getattr(linked, "kernel_apart", None)
        found |= dict.fromkeys(getattr(linked, "kernel_calls", ()) if itself is None else (itself,))
    return tuple(found)


def _is_there(call: _Call) -> bool:
    """Load a kernel, or compile it; whether its machine code has the symbol that is asked for."""
    dispatcher = getattr(importlib.import_module(call.module), call.name)
    dispatcher.compile(call.arguments)
    return bool(dispatcher.overloads[call.arguments].fndesc.mangled_name == call.symbol)


class _Kept(CompileResultCacheImpl):
    """What is kept of a kernel: numba's own, and what it calls."""

    def reduce(self, data: Any) -> Any:
        library = data.library
        itself = getattr(library, "kernel_apart", None)
        return itself, library.kernel_calls, super().reduce(data)

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        itself, calls, kept = payload
        # Machine code that is loaded before what it jumps to ends the process.
        if not all(_is_there(call) for call in calls):
            return None
        found = super().rebuild(target_context, kept)
        found.library.kernel_calls = calls
        if itself is not None:
            found.library.kernel_apart = itself
        return found


class KernelCache(FunctionCache):
    """The cache of one kernel, in the folder that numba chooses for it.

    That is ``NUMBA_CACHE_DIR``, else ``__pycache__`` beside the file, else the user's cache folder.
    """

    _impl_class = _Kept

    def __init__(self, function: Any, *, apart: bool = False) -> None:
        """Find the folder.

        Raises:
            RuntimeError: If there is no folder to write to, or the sources are not in this one.
        """
        self._key, self._apart = _contents_at_start(), apart
        super().__init__(function)
        if Path(function.__code__.co_filename).resolve().parent != _FOLDER:
            raise RuntimeError(f"{function.__module__} does not lie in {_FOLDER}")
        module = function.__module__.rpartition(".")[2]
        self._kernel = f"{module}.{function.__name__}"
        self._python = f"py{sys.version_info[0]}{sys.version_info[1]}{sys.abiflags}"
        name = f"{self._kernel}-{self._key[:16]}.{self._python}"
        self._cache_file = IndexDataCacheFile(self.cache_path, name, self._key)
        self._lock = CompileLock(Path(self.cache_path) / f"{name}.lock")

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Machine code that is kept, or that another process is compiling; else ``None``."""
        found = super().load_overload(sig, target_context)
        if found is None and self._lock.acquire():
            found = super().load_overload(sig, target_context)
        if found is not None:
            self._lock.release()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the machine code of one signature, unless the sources were edited meanwhile.

        Modules that were imported before and after an edit make code that belongs to no sources. A
        folder that cannot be written to (a full disk) costs time at the next start, but no step.
        """
        data.library.kernel_calls = _calls_of(data.library)
        # Where another numba does not know these, kernels are put into their callers as ever.
        known = hasattr(data.library, "_shared_module") and hasattr(
            data.library, "_linking_libraries"
        )
        if self._apart and known:
            function = self._py_func
            data.library.kernel_apart = _Call(
                function.__module__, function.__name__, tuple(sig), data.fndesc.mangled_name
            )
            data.library._shared_module = parse_assembly("")  # what its callers are linked with
        try:
            if _contents() == self._key:
                super().save_overload(sig, data)
                self._remove_other_sources()
        except OSError:
            pass
        finally:
            self._lock.release()

    def _remove_other_sources(self) -> None:
        for file in Path(self.cache_path).glob(f"{self._kernel}-*.{self._python}.*"):
            if self._key[:16] not in file.name and file.suffix in (".nbi", ".nbc"):
                file.unlink(missing_ok=True)

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        versions = np.__version__, llvmlite.__version__
        return (*super()._index_key(sig, codegen), versions)
