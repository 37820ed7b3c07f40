"""On what, and with what, a run was measured."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from pydantic import BaseModel, ConfigDict

_PACKAGES = (
    "qp_twist", "numpy", "scipy", "mujoco", "mink", "qpsolvers", "daqp", "proxsuite", "osqp",
    "piqp", "quadprog", "clarabel", "numba", "pin", "pin-pink", "placo",
)  # fmt: skip
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS", "NUMBA_NUM_THREADS")


class Machine(BaseModel):
    """What times depend on beside the code.

    Attributes:
        processor: Its name, as the system knows it.
        cores: How many the system shows.
        system: Operating system and architecture.
        threads: Environment variables that say how many threads libraries take.
        versions: Of Python and of the packages that are installed.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    processor: str
    cores: int
    system: str
    threads: dict[str, str]
    versions: dict[str, str]

    @classmethod
    def here(cls) -> Machine:
        """This one."""
        return cls(
            processor=_processor(),
            cores=os.cpu_count() or 1,
            system=f"{platform.system()} {platform.machine()}",
            threads={name: os.environ[name] for name in _THREADS if name in os.environ},
            versions={"python": platform.python_version()} | _versions(),
        )

    def in_words(self) -> str:
        """A line for people."""
        return f"{self.processor}, {self.cores} cores, {self.system}"


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text("utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or "unknown processor"


def _versions() -> dict[str, str]:
    found = {}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
