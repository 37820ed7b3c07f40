"""Run a job on every sample by joblib: in processes of this machine, or on a Dask cluster.

A process that dies (out of memory, killed, crashed in native code) ends joblib's call: the samples
under way are run again, each alone, and the one that kills its process again is given up.
"""

from __future__ import annotations

import pickle
import warnings
import zlib
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import lru_cache
from importlib.util import find_spec
from typing import Any, Protocol

from qp_twist.checks import clause
from qp_twist.errors import InvalidInput

Rows = list[dict[str, Any]]


def check_installed() -> None:
    """Raise if joblib is missing.

    Raises:
        InvalidInput: With the extra to install.
    """
    if find_spec("joblib") is None:
        raise InvalidInput("study: needs joblib; install the extra: qp_twist[study].")


def check_jobs(jobs: int) -> int:
    """A number of processes, 1 or more.

    Raises:
        InvalidInput: If it is another number.
    """
    if isinstance(jobs, bool) or not isinstance(jobs, int) or jobs < 1:
        raise InvalidInput(
            f"expected 1 process or more, got {jobs!r}; give another number, or leave it out.",
            key="jobs",
        )
    return jobs


class Work(Protocol):
    """The job for a sample. It can be pickled."""

    def __call__(self, index: int) -> Rows:
        """The rows of a sample. Does not raise."""

    def failed(self, index: int, message: str) -> Rows:
        """The rows of a sample whose process died."""


def each(
    job: Work, indices: Sequence[int], *, jobs: int | None, scheduler: str | None = None
) -> Generator[tuple[int, Rows]]:
    """Yield each index with the rows of ``job(index)``, in the order in which they are done.

    In so many processes on this machine, one per core if ``None``, or by the workers of a Dask
    scheduler.

    Raises:
        InvalidInput: If there is no such scheduler, or it has no workers.
    """
    from joblib import Parallel, delayed

    # The job goes along with every call: a task of 2 to 4 MB takes 0.1 to 0.2 MB compressed. Sent
    # once to all workers, it would be lost with one of them: Dask drops the other copies.
    packed, died = zlib.compress(pickle.dumps(job)), _deaths()
    left = dict.fromkeys(indices)
    under_way: list[int] = []

    def run(samples: Sequence[int]) -> Generator[tuple[int, Rows]]:
        def calls() -> Iterator[Any]:
            for index in samples:
                under_way.append(index)
                yield delayed(_do)(packed, index)

        ahead = 1 if jobs == 1 else "2 * n_jobs"
        parallel = Parallel(batch_size=1, pre_dispatch=ahead, return_as="generator_unordered")
        results = parallel(calls())
        try:
            for result in results:  # noqa: UP028 (its end is the next lines')
                yield result
        finally:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of samples that are not waited for
                results.close()

    with _backend(jobs, scheduler):
        alone: list[int] = []
        while left:
            under_way.clear()
            samples = alone[:1] or list(left)
            try:
                with closing(run(samples)) as found:
                    for index, rows in found:
                        del left[index]
                        yield index, rows
            except died as error:
                if alone:
                    why = str(error).strip().partition("\n")[0]
                    message = f"its process died: {type(error).__name__}: {why}"
                    del left[alone[0]]
                    yield alone[0], job.failed(alone[0], message)
                else:
                    alone = [index for index in under_way if index in left]
                    continue
            alone = alone[1:]


def _do(packed: bytes, index: int) -> tuple[int, Rows]:
    return index, _job(packed)(index)


@lru_cache(maxsize=1)
def _job(packed: bytes) -> Work:
    """The job, unpacked once per process."""
    job: Work = pickle.loads(zlib.decompress(packed))
    return job


def _deaths() -> tuple[type[Exception], ...]:
    """What joblib's call raises when a process dies."""
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    try:
        from distributed import KilledWorker
    except ImportError:
        return (TerminatedWorkerError,)
    return TerminatedWorkerError, KilledWorker


@contextmanager
def _backend(jobs: int | None, scheduler: str | None) -> Iterator[None]:
    """Have joblib use the processes of this machine, or the workers of a scheduler."""
    from joblib import parallel_config

    if scheduler is None:
        # With one process joblib would take this one, which then dies of a sample that kills it.
        count = -1 if jobs is None else max(2, jobs)
        with parallel_config("loky", n_jobs=count, inner_max_num_threads=1):
            yield
        return
    try:
        from distributed import Client
    except ImportError:
        raise InvalidInput(
            "study(scheduler=…): Dask is not installed; install the extra: qp_twist[cluster]."
        ) from None
    try:
        client = Client(scheduler, timeout=5, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InvalidInput(
            f"study(scheduler={scheduler!r}): {clause(error)}. Start one by `dask scheduler`, and "
            "workers; or leave the scheduler out."
        ) from error
    with client:
        if not client.ncores():
            raise InvalidInput(f"study(scheduler={scheduler!r}): it has no workers; start some.")
        with parallel_config("dask", n_jobs=-1, client=client):
            yield
