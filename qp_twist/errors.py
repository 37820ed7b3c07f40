"""The exceptions of refused input; those of a failed step are in ``qp_twist.qp.failures``.

All derive from :class:`QpTwistError`, itself a :class:`mink.MinkError`; if mink or qpsolvers has an
exception with the same meaning, the class derives from it, too, so that the handlers of a mink app
catch it.
"""

from __future__ import annotations

import mink
import qpsolvers


class QpTwistError(mink.MinkError):
    """Base class of the exceptions of qp_twist."""


class InvalidInput(QpTwistError, ValueError):
    """An argument was refused: the message has the value, what was expected, and what to do."""


class InvalidTarget(InvalidInput, mink.InvalidTarget):
    """A target pose or twist was refused (not finite, or of the wrong shape)."""


class UnknownSolver(InvalidInput, qpsolvers.SolverNotFound):
    """The QP solver is not known to qpsolvers, or is not installed.

    Also a qpsolvers exception, which mink passes through, for the handlers of its apps.
    """


class TaskFileError(InvalidInput):
    """A task file cannot be read; the message names the file, the line where known, and the key."""
