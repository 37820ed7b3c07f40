"""What all tests share: settings, and the two comparisons that many of them look at."""

import pytest
from hypothesis import settings
from skips import pytest_make_collect_report, pytest_runtest_makereport  # noqa: F401  (hooks)

import qp_twist as qt

# The same examples on every machine: a red run can be repeated, a green one means the same.
settings.register_profile("qp_twist", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("qp_twist")


SHARED = ("deburring", "planar")


@pytest.hookimpl(tryfirst=True)  # before xdist reads the marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests that look at a shared comparison go to one process, which makes it once."""
    for item in items:
        used = [name for name in SHARED if name in getattr(item, "fixturenames", ())]
        if used:
            item.add_marker(pytest.mark.xdist_group(used[0]))


@pytest.fixture(scope="session")
def deburring() -> qt.Comparison:
    """Every method on the deburring lap."""
    return qt.compare("deburring")


@pytest.fixture(scope="session")
def planar() -> qt.Comparison:
    """Every method on the planar line."""
    return qt.compare("planar_line")
