"""Run a job on every sample, in processes of this machine or of a cluster.

Both use futures: joblib's process pool (loky) on this machine, Dask's workers on a cluster. A
process that dies (out of memory, killed, crashed in native code) breaks loky's pool: it is
recreated, and the interrupted samples are run again. Dask does this itself.
"""

from __future__ import annotations

import pickle
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from concurrent.futures.process import BrokenProcessPool
from functools import lru_cache
from importlib.util import find_spec
from typing import Any, Protocol

from qp_twist.checks import clause
from qp_twist.errors import InvalidInput

Rows = list[dict[str, Any]]

TRIES = 2
"""Number of deaths of its process after which a sample is given up."""
_AHEAD = 2
"""Number of queued samples per process."""
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def check_installed() -> None:
    """Raise if joblib is missing.

    Raises:
        InvalidInput: With the extra to install.
    """
    if find_spec("joblib") is None:
        raise InvalidInput("study: needs joblib; install the extra: qp_twist[study].")


class Work(Protocol):
    """The job for a sample."""

    def __call__(self, index: int) -> Rows:
        """The rows of a sample. Does not raise."""

    def failed(self, index: int, message: str) -> Rows:
        """The rows of a sample whose process died."""


def each(
    job: Work, indices: Sequence[int], *, jobs: int | None, scheduler: str | None = None
) -> Iterator[tuple[int, Rows]]:
    """Yield each index with the rows of ``job(index)``, in the order in which they are done.

    Args:
        job: Can be pickled.
        indices: Indices of the samples.
        jobs: Number of processes on this machine; one per core if ``None``.
        scheduler: Address of a Dask scheduler whose workers are used instead.

    Raises:
        InvalidInput: If there is no such scheduler, or it has no workers.
    """
    pool = _Here(job, jobs) if scheduler is None else _Cluster(job, scheduler)
    deaths: Counter[int] = Counter()
    waiting = deque(indices)
    under_way: dict[Future[Rows], int] = {}
    try:
        while waiting or under_way:
            while waiting and len(under_way) < pool.room():
                # A sample that ran when a process died is run alone, to identify the cause.
                last_try = {i for i in (*under_way.values(), waiting[0]) if deaths[i] == TRIES - 1}
                if last_try and under_way:
                    break
                index = waiting.popleft()
                under_way[pool.submit(index)] = index
            done, _ = wait(under_way, return_when=FIRST_COMPLETED)
            if any(isinstance(future.exception(), BrokenProcessPool) for future in done):
                done, _ = wait(under_way)
                pool.renew()
            for future in done:
                index = under_way.pop(future)
                error = future.exception()
                if error is None:
                    yield index, future.result()
                    continue
                deaths[index] += 1
                if isinstance(error, BrokenProcessPool) and deaths[index] < TRIES:
                    waiting.appendleft(index)
                    continue
                message = str(error).strip().partition("\n")[0]
                yield (
                    index,
                    job.failed(index, f"its process died: {type(error).__name__}: {message}"),
                )
    finally:
        for future in under_way:
            future.cancel()
        pool.close()


@lru_cache(maxsize=1)
def _job(pickled: bytes) -> Work:
    """The job, unpickled once per process."""
    job: Work = pickle.loads(pickled)
    return job


def _do(pickled: bytes, index: int) -> Rows:
    return _job(pickled)(index)


class _Here:
    """Processes of this machine."""

    def __init__(self, job: Work, jobs: int | None) -> None:
        from joblib import cpu_count

        self._job = pickle.dumps(job)
        self._jobs: int = jobs or cpu_count()
        self.renew()

    def renew(self) -> None:
        """Replace a broken pool."""
        from joblib.externals.loky import get_reusable_executor

        self._executor = get_reusable_executor(self._jobs, env=_ONE_THREAD, timeout=60)

    def room(self) -> int:
        """Largest number of queued samples."""
        return _AHEAD * self._jobs

    def submit(self, index: int) -> Future[Rows]:
        """Submit a sample."""
        future: Future[Rows] = self._executor.submit(_do, self._job, index)
        return future

    def close(self) -> None:
        """Terminate the processes."""
        self._executor.shutdown(wait=True, kill_workers=True)


class _Cluster:
    """The workers of a Dask scheduler."""

    def __init__(self, job: Work, scheduler: str) -> None:
        try:
            from distributed import Client
        except ImportError:
            raise InvalidInput(
                "study(scheduler=…): Dask is not installed; install the extra: qp_twist[cluster]."
            ) from None
        try:
            self._client = Client(scheduler, timeout=5, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InvalidInput(
                f"study(scheduler={scheduler!r}): {clause(error)}. Start one by `dask "
                "scheduler`, and workers; or leave the scheduler out."
            ) from error
        if not self._client.ncores():
            self._client.close()
            raise InvalidInput(f"study(scheduler={scheduler!r}): it has no workers; start some.")
        self._executor: Executor = self._client.get_executor(pure=False)
        # As a separate task, which the scheduler can rerun if its result is lost.
        self._job = self._client.submit(bytes, pickle.dumps(job))

    def renew(self) -> None:
        """Nothing to do: the scheduler manages its workers."""

    def room(self) -> int:
        """Largest number of queued samples."""
        return _AHEAD * max(1, sum(int(n) for n in self._client.ncores().values()))

    def submit(self, index: int) -> Future[Rows]:
        """Submit a sample."""
        return self._executor.submit(_do, self._job, index)

    def close(self) -> None:
        """Disconnect from the scheduler."""
        self._executor.shutdown(wait=False)
        self._client.close()
