"""How the kernels are compiled.

Machine code is kept beside the sources. It is made anew where the file of a kernel has changed, not
where only that of a kernel which it calls has: whoever works on them removes ``__pycache__``.
"""

from __future__ import annotations

from typing import Any

from numba import njit

_njit: Any = njit  # some of these options are left out of its signature

kernel: Any = _njit(cache=True, error_model="numpy", nogil=True, _nrt=True)
"""For what makes arrays."""
plain: Any = _njit(cache=True, error_model="numpy", nogil=True, _nrt=False)
"""For all other kernels. They make no arrays, and what they return are views without an owner
(``views``), so that nothing has to be counted: counting the references to ten small arrays takes
longer than a matrix product of theirs."""
part: Any = _njit(cache=True, error_model="numpy", nogil=True, _nrt=False, inline="always")
"""For a piece of a long kernel, compiled as if it were written there. A kernel is optimised again
within every kernel that calls it, so that a long chain of calls takes long to compile."""
