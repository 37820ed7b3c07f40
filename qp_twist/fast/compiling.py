"""How the kernels are compiled.

Machine code is kept beside the sources. It is made anew where the file of a kernel has changed, not
where only that of a kernel which it calls has: whoever works on them removes ``__pycache__``.
"""

from __future__ import annotations

from typing import Any

from numba import njit

kernel: Any = njit(cache=True, error_model="numpy", nogil=True)
"""For what is called from Python, makes arrays, or returns views of them."""
plain: Any = njit(cache=True, error_model="numpy", nogil=True, _nrt=False)  # type: ignore[call-overload]
"""For all other kernels. They neither make nor return arrays, so that nothing has to be counted:
counting the references to ten small arrays takes longer than a matrix product of theirs."""
