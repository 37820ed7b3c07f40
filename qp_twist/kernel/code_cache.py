"""The disk cache of the kernels' machine code, keyed by the contents of all kernel sources.

**Key.** numba discards cached machine code only if the function's own file changes. But a kernel
also contains the code of the kernels that it calls, most of them in other files: after an edit
there, or an upgrade of the package, numba would run outdated code. Here an entry is keyed by a hash
of all files in this folder. numba adds the processor and the function's bytecode; this module adds
the versions of numba, NumPy and llvmlite.

**Files.** The entries for one state of the sources lie in a folder that is named by their hash, so
processes with different sources never load each other's code. Saving a kernel deletes the folders
of other sources: each version of Python keeps one generation, about 10 MB. Each entry begins with a
checksum. An entry that is damaged (an empty file after a power cut, a full disk) is compiled again.

**Separate linking.** numba copies the code of a kernel into every kernel that calls it and
optimises each copy, ten times over at the top of a chain of ten calls. Most kernels here are too
long to gain from inlining. They are compiled ``apart``: a caller contains only a reference to the
symbol. This halves the compilation time of a step. A cache entry lists the kernels that it calls
and their symbols; these are loaded first.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import pickle
import shutil
import sys
import uuid
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite
import numba
import numpy as np
from llvmlite.binding import parse_assembly
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.serialize import dumps

from qp_twist.kernel.compile_lock import CompileLock

_FOLDER = Path(__file__).resolve().parent


def _contents() -> str:
    """Hash of the names and contents of all Python files in this folder.

    Raises:
        RuntimeError: If there are none, as in a package shipped without its sources.
    """
    files = sorted(_FOLDER.glob("*.py"))
    if not files:
        raise RuntimeError("the sources of the kernels are not there")
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.name.encode() + b"\0" + hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


_contents_at_start = cache(_contents)
"""The hash at the time when the first kernel of this process was declared."""


class _Call(NamedTuple):
    """A reference to a kernel that is compiled ``apart``."""

    module: str
    name: str
    arguments: tuple[Any, ...]
    symbol: str
    """Symbol of its machine code; differs in each process that compiles it."""


def _calls_of(library: Any) -> tuple[_Call, ...]:
    """The kernels compiled ``apart`` that a kernel calls."""
    found = dict[_Call, None]()
    for linked in getattr(library, "_linking_libraries", ()):
        itself: _Call | None = getattr(linked, "kernel_apart", None)
        found |= dict.fromkeys(getattr(linked, "kernel_calls", ()) if itself is None else (itself,))
    return tuple(found)


def _is_there(call: _Call) -> bool:
    """Load or compile a kernel; return whether its machine code has the expected symbol."""
    dispatcher = getattr(importlib.import_module(call.module), call.name)
    dispatcher.compile(call.arguments)
    return bool(dispatcher.overloads[call.arguments].fndesc.mangled_name == call.symbol)


class _CacheEntry(CompileResultCacheImpl):
    """Contents of a cache entry: numba's own, and the kernels that it calls."""

    def reduce(self, data: Any) -> Any:
        library = data.library
        itself = getattr(library, "kernel_apart", None)
        return itself, library.kernel_calls, super().reduce(data)

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        itself, calls, kept = payload
        # Machine code with an unresolved call would crash the process: load the callees first.
        if not all(_is_there(call) for call in calls):
            return None
        found = super().rebuild(target_context, kept)
        found.library.kernel_calls = calls
        if itself is not None:
            found.library.kernel_apart = itself
        return found


class _Entries:
    """The machine code of one kernel on disk: a file for each signature."""

    def __init__(self, folder: Path, kernel: str) -> None:
        self._folder, self._kernel = folder, kernel

    def _file(self, key: Any) -> Path:
        signature = hashlib.sha256(repr(key).encode()).hexdigest()[:16]
        return self._folder / f"{self._kernel}.{signature}.nbc"

    def load(self, key: Any) -> Any:
        """The entry of a key; ``None`` if there is none, or it is damaged."""
        try:
            content = self._file(key).read_bytes()
        except OSError:
            return None
        checksum, data = content[:32], content[32:]
        return pickle.loads(data) if hashlib.sha256(data).digest() == checksum else None

    def save(self, key: Any, entry: Any) -> None:
        """Write an entry to a temporary file, then rename it.

        Raises:
            OSError: If that is not possible; no file is left then.
        """
        data = dumps(entry)
        self._folder.mkdir(exist_ok=True)
        unfinished = self._folder / f"{uuid.uuid4().hex}.tmp"
        try:
            unfinished.write_bytes(hashlib.sha256(data).digest() + data)
            unfinished.replace(self._file(key))
        finally:
            unfinished.unlink(missing_ok=True)

    def flush(self) -> None:
        """Delete all entries."""
        for file in self._folder.glob(f"{self._kernel}.*.nbc"):
            file.unlink(missing_ok=True)


class KernelCache(FunctionCache):
    """The cache of one kernel, in the folder that numba chooses.

    This is ``NUMBA_CACHE_DIR``, else ``__pycache__`` beside the file, else the user's cache folder.
    """

    _impl_class = _CacheEntry

    def __init__(self, function: Any, *, apart: bool = False) -> None:
        """Find the folder.

        Raises:
            RuntimeError: If no folder is writable, or the function is not defined in this folder.
        """
        self._key, self._apart = _contents_at_start(), apart
        super().__init__(function)
        if Path(function.__code__.co_filename).resolve().parent != _FOLDER:
            raise RuntimeError(f"{function.__module__} does not lie in {_FOLDER}")
        self._python = f"py{sys.version_info[0]}{sys.version_info[1]}{sys.abiflags}"
        self._folder = Path(self.cache_path) / f"kernels-{self._key[:16]}.{self._python}"
        with contextlib.suppress(OSError):
            self._folder.mkdir(exist_ok=True)
        kernel = f"{function.__module__.rpartition('.')[2]}.{function.__name__}"
        self._cache_file: Any = _Entries(self._folder, kernel)
        self._lock = CompileLock(self._folder / f"{kernel}.lock")

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load cached machine code, after another process that compiles it; ``None`` for none."""
        found = super().load_overload(sig, target_context)
        if found is None and self._lock.acquire():
            found = super().load_overload(sig, target_context)
        if found is not None:
            self._lock.release()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save the machine code of one signature, unless the sources were edited meanwhile.

        Modules imported before and after an edit yield code that matches neither version of the
        sources. A folder that cannot be written to (a full disk) only costs compilation at the next
        start.
        """
        data.library.kernel_calls = _calls_of(data.library)
        # Versions of numba without these attributes inline every kernel, as usual.
        known = hasattr(data.library, "_shared_module") and hasattr(
            data.library, "_linking_libraries"
        )
        if self._apart and known:
            function = self._py_func
            data.library.kernel_apart = _Call(
                function.__module__, function.__name__, tuple(sig), data.fndesc.mangled_name
            )
            data.library._shared_module = parse_assembly("")  # linked into its callers
        try:
            if _contents() == self._key:
                super().save_overload(sig, data)
                self._remove_other_sources()
        except OSError:
            pass
        finally:
            self._lock.release()

    def _remove_other_sources(self) -> None:
        for folder in Path(self.cache_path).glob(f"kernels-*.{self._python}"):
            if folder != self._folder:
                shutil.rmtree(folder, ignore_errors=True)

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        versions = numba.__version__, np.__version__, llvmlite.__version__
        return (*super()._index_key(sig, codegen), versions)
