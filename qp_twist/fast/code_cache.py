"""Where the machine code of kernels is kept, and which sources it belongs to.

numba keeps the machine code of a function for as long as the function's own file stays as it is. A
kernel also contains the machine code of the kernels that it calls, most of them in other files, so
that an edit there, or an upgrade of the package, would go on running the code of before. So an
entry belongs to the contents of all files of this folder together. numba adds its own version, the
processor and the bytecode of the function; the versions of NumPy and llvmlite are added here.

The names of the files contain the key, so that processes which run different sources never read
each other's code. Whoever stores a kernel removes the same kernel's files of other sources: one
generation is kept for each version of Python, some 10 MB.
"""

from __future__ import annotations

import contextlib
import hashlib
import sys
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite
import numpy as np
from numba.core.caching import FunctionCache, IndexDataCacheFile

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


class KernelCache(FunctionCache):
    """The cache of one kernel, in the folder that numba chooses for it.

    That is ``NUMBA_CACHE_DIR``, else ``__pycache__`` beside the file, else the user's cache folder.
    """

    def __init__(self, function: Any) -> None:
        """Find the folder.

        Raises:
            RuntimeError: If there is no folder to write to, or the sources are not in this one.
        """
        self._key = _contents_at_start()
        super().__init__(function)
        if Path(function.__code__.co_filename).resolve().parent != _FOLDER:
            raise RuntimeError(f"{function.__module__} does not lie in {_FOLDER}")
        module = function.__module__.rpartition(".")[2]
        self._kernel = f"{module}.{function.__name__}"
        self._python = f"py{sys.version_info[0]}{sys.version_info[1]}{sys.abiflags}"
        name = f"{self._kernel}-{self._key[:16]}.{self._python}"
        self._cache_file = IndexDataCacheFile(self.cache_path, name, self._key)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the machine code of one signature, unless the sources were edited meanwhile.

        Modules that were imported before and after an edit make code that belongs to no sources. A
        folder that cannot be written to (a full disk) costs time at the next start, but no step.
        """
        with contextlib.suppress(OSError):
            if _contents() == self._key:
                super().save_overload(sig, data)
                self._remove_other_sources()

    def _remove_other_sources(self) -> None:
        for file in Path(self.cache_path).glob(f"{self._kernel}-*.{self._python}.*"):
            if self._key[:16] not in file.name and file.suffix in (".nbi", ".nbc"):
                file.unlink(missing_ok=True)

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        versions = np.__version__, llvmlite.__version__
        return (*super()._index_key(sig, codegen), versions)
