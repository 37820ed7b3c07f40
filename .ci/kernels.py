"""Run the numerical tests again, on other kernels of OpenBLAS than the one that fits this machine.

    python .ci/kernels.py [pytest's options]

OpenBLAS, which NumPy's and SciPy's wheels bring along, sums in another order on another processor,
so that a result that hangs on rounding is right on one machine and wrong on the next. Its
``OPENBLAS_CORETYPE`` chooses a kernel by the name of a processor. Taken are the first two of the
names below that this machine can run and whose results differ, in their last digits, from those of
its own kernel, on which all tests run already, and from each other's: three kernels in all.
``QP_TWIST_KERNELS`` is another number than two.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from numerical import paths  # noqa: E402

NAMES = ("Haswell", "Zen", "SkylakeX", "Sandybridge", "Nehalem", "Prescott")
WANTED = int(os.environ.get("QP_TWIST_KERNELS", "2"))
DIGITS = """
import hashlib, numpy as np, scipy.linalg
digits = hashlib.sha256()
for n in (3, 6, 7, 16, 40):
    A = np.random.default_rng(n).normal(size=(n, n))
    for linalg in (np.linalg, scipy.linalg):
        for part in linalg.svd(A @ A.T + A):
            digits.update(part.tobytes())
print(digits.hexdigest())
"""


def with_kernel(name: str | None) -> dict[str, str]:
    """The environment that makes OpenBLAS take a kernel; its own choice if ``None``."""
    environment = {k: v for k, v in os.environ.items() if k != "OPENBLAS_CORETYPE"}
    return environment | ({"OPENBLAS_CORETYPE": name} if name else {})


def digits(name: str | None) -> str:
    """What a kernel makes of some matrices; empty if the processor lacks its instructions."""
    command = [sys.executable, "-c", DIGITS]
    done = subprocess.run(
        command, env=with_kernel(name), capture_output=True, text=True, check=False
    )
    return done.stdout.strip() if done.returncode == 0 else ""


def chosen() -> list[str]:
    """The kernels to run the tests on."""
    seen, names = {digits(None)}, []
    for name in NAMES:
        found = digits(name)
        if not found:
            print(f"kernels: {name} is left out: this processor lacks its instructions")
        elif found in seen:
            print(f"kernels: {name} is left out: it is the same code as one before")
        else:
            seen.add(found)
            names.append(name)
    return names[:WANTED]


def main() -> int:
    """The worst exit status of pytest."""
    if platform.machine().lower() not in ("x86_64", "amd64"):
        print(f"kernels: on {platform.machine()} there is no choice of kernels; left out")
        return 0
    names = chosen()
    if not names:
        print("kernels: NumPy's BLAS has no kernels to choose from (it is not OpenBLAS); left out")
    worst = 0
    for name in names:
        print(f"+ OPENBLAS_CORETYPE={name} pytest -m numerical", flush=True)
        command = [sys.executable, "-m", "pytest", "-q", "-m", "numerical", *sys.argv[1:], *paths()]
        done = subprocess.run(command, env=with_kernel(name), cwd=ROOT, check=False)
        worst = max(worst, abs(done.returncode))
    return worst


if __name__ == "__main__":
    sys.exit(main())
