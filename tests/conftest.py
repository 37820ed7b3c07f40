"""What all tests share: settings, marks, and the two comparisons that many of them look at."""

from pathlib import Path

import pytest
from hypothesis import settings
from skips import pytest_make_collect_report, pytest_runtest_makereport  # noqa: F401  (hooks)

import qp_twist as qt

# The same examples on every machine: a red run can be repeated, a green one means the same.
settings.register_profile("qp_twist", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("qp_twist")


SHARED = ("deburring", "planar")

NOT_NUMERICAL = (
    "bench", "check", "cli", "docs", "examples", "exchange", "findings", "gallery", "house",
    "new_task", "peers", "refusals", "report", "resample", "robots", "scenes", "study",
    "task_file", "toolpath", "view", "viewing",
    "code_cache", "files", "local_server", "shown", "skips",
    "batch", "batch_steps", "comparison", "compiled_paths", "named_tasks", "paper_examples",
    "placements", "plan", "plan_bands", "simulation", "starts_found", "timing",
)  # fmt: skip
"""Modules ``test_…`` without the mark ``numerical``: files, pages, pictures and commands; and
motions along whole paths and many steps at once, which take minutes and are made of the steps that
the others test. All others have it, new ones as well, and run on several kernels of OpenBLAS
(``.ci/kernels.py``)."""


@pytest.hookimpl(tryfirst=True)  # before xdist reads the marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark numerical tests, and those of a shared comparison: one process makes it, once."""
    here = Path(__file__).parent
    others = {f"test_{name}" for name in NOT_NUMERICAL}
    gone = [name for name in others if not (here / f"{name}.py").exists()]
    if gone:
        raise pytest.UsageError(f"conftest.py: NOT_NUMERICAL lists {gone}, which are not there")
    for item in items:
        used = [name for name in SHARED if name in getattr(item, "fixturenames", ())]
        if used:
            item.add_marker(pytest.mark.xdist_group(used[0]))
        elif item.path.parent == here and item.path.stem not in others:
            item.add_marker(pytest.mark.numerical)


@pytest.fixture(scope="session")
def deburring() -> qt.Comparison:
    """Every method on the deburring run."""
    return qt.compare("deburring")


@pytest.fixture(scope="session")
def planar() -> qt.Comparison:
    """Every method on the planar line."""
    return qt.compare("planar_line")
