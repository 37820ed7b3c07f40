"""Where it is stated what may be missing, a test that is skipped for another reason fails.

``QP_TWIST_MAY_SKIP`` holds words, e.g. ``"robosuite browser"``: a reason that has none of them is a
failure. ``.ci/run`` sets it, so that a numba that is missing, or no longer imports, cannot turn off
the tests of the compiled step without anybody seeing it. Without the variable skips are skips.
"""

import os
from collections.abc import Generator
from typing import Any

import pytest

ALLOWED = "QP_TWIST_MAY_SKIP"


def _refuse(report: pytest.TestReport | pytest.CollectReport) -> None:
    if ALLOWED not in os.environ or report.outcome != "skipped" or hasattr(report, "wasxfail"):
        return
    reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    words = os.environ[ALLOWED].split()
    if any(word.lower() in reason.lower() for word in words):
        return
    report.outcome = "failed"
    report.longrepr = (
        f"{report.nodeid}: {reason}\nOnly what has one of these words in its reason may be skipped "
        f"here: {', '.join(words) or 'none'} ({ALLOWED})."
    )


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, Any, Any]:
    """Of a test."""
    report = yield
    _refuse(report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, Any, Any]:
    """Of a whole file."""
    report = yield
    _refuse(report)
    return report
