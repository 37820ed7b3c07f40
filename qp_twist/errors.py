"""The exceptions of refused input; those of a failed step are in ``qp_twist.qp.failures``.

All derive from :class:`QpTwistError`, itself a :class:`mink.MinkError`; if mink or qpsolvers has an
exception with the same meaning, the class derives from it, too, so that the handlers of a mink app
catch it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import mink
import qpsolvers


class QpTwistError(mink.MinkError):
    """Base class of the exceptions of qp_twist."""


class InvalidInput(QpTwistError, ValueError):
    """An argument was refused: the message has the value, what was expected, and what to do.

    The message is ``file, line 3, column: key: sentence``, without what is not known.

    Attributes:
        sentence: What is wrong and what to do, without the place.
        file: File that it is about.
        line: Line of the file, from 1.
        column: Column of a table, or word in the line.
        key: Name of the argument, or dotted key of the task file.
        options: Options of a toolpath that settle it, each with its value; ``None``: to be chosen.
    """

    def __init__(
        self,
        sentence: str,
        *,
        file: object = "",
        line: int | None = None,
        column: str = "",
        key: str = "",
        options: Mapping[str, str | None] | None = None,
    ) -> None:
        super().__init__(sentence)
        self.sentence, self.file, self.key = sentence, str(file), key
        self.line, self.column = line, column
        self.options = dict(options or {})

    def __str__(self) -> str:
        """The message."""
        line = "" if self.line is None else f"line {self.line}"
        place = ", ".join(filter(None, (self.file, line, self.column)))
        return ": ".join(filter(None, (place, self.key, self.sentence)))


@contextmanager
def about(key: str) -> Iterator[None]:
    """What is refused inside is about ``key``, or about a key inside it."""
    try:
        yield
    except InvalidInput as error:
        error.key = ".".join(filter(None, (key, error.key)))
        raise


class InvalidTarget(InvalidInput, mink.InvalidTarget):
    """A target pose or twist was refused (not finite, or of the wrong shape)."""


class UnknownSolver(InvalidInput, qpsolvers.SolverNotFound):
    """The QP solver is not known to qpsolvers, or is not installed.

    Also a qpsolvers exception, which mink passes through, for the handlers of its apps.
    """


class TaskFileError(InvalidInput):
    """A task file cannot be read; the message names the file, the line where known, and the key."""
