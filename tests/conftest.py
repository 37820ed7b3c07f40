"""What all tests share: settings, marks, and what several of them look at."""

import os

import numerical
import pytest
from hypothesis import settings
from skips import pytest_make_collect_report, pytest_runtest_makereport  # noqa: F401  (hooks)

import qp_twist as qt
from qp_twist.drawing import NoPicture

# The same examples on every machine: a red run can be repeated, a green one means the same. On
# another kernel of OpenBLAS (.ci/kernels.py) fewer of them.
settings.register_profile(
    "qp_twist", max_examples=20 if "OPENBLAS_CORETYPE" in os.environ else 40, deadline=None,
    derandomize=True, print_blob=True,
)  # fmt: skip
settings.load_profile("qp_twist")


SHARED = ("deburring", "planar", "twelve", "billion")
"""Fixtures that take seconds: all tests that use one of them run in the same process."""


@pytest.hookimpl(tryfirst=True)  # before xdist reads the marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark numerical tests, and those of a shared comparison: one process makes it, once."""
    gone = [name for name in numerical.FOLDERS if not (numerical.HERE / name).is_dir()]
    if gone:
        raise pytest.UsageError(f"numerical.py: FOLDERS lists {gone}, which are not there")
    # Not at the end, where the other process would be idle while one waits for a browser.
    items.sort(key=lambda item: item.path.parent.name != "viewing")
    for item in items:
        used = [name for name in SHARED if name in getattr(item, "fixturenames", ())]
        if used:
            item.add_marker(pytest.mark.xdist_group(used[0]))
        elif any(item.get_closest_marker(mark) for mark in numerical.EXCEPT):
            continue
        elif item.path.parent in [numerical.HERE / name for name in numerical.FOLDERS]:
            item.add_marker(pytest.mark.numerical)


@pytest.fixture(scope="session")
def deburring() -> qt.Comparison:
    """Every method on the deburring run."""
    return qt.compare("deburring")


@pytest.fixture(scope="session")
def planar() -> qt.Comparison:
    """Every method on the planar line."""
    return qt.compare("planar_line")


def no_picture(*_: object, **__: object) -> bytes:
    """Instead of a picture, which takes longer to draw than all the rest of a page."""
    raise NoPicture("No picture of the scene.")


@pytest.fixture
def without_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages have no picture for print."""
    monkeypatch.setattr("qp_twist.drawing.picture.draw_scene", no_picture)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports are written with empty pages and no pictures: drawing takes longer than the rest."""
    monkeypatch.setattr(qt.Comparison, "figures", lambda _: {})
    monkeypatch.setattr("qp_twist.drawing.picture.draw_scene", no_picture)
    monkeypatch.setattr("qp_twist.pages.comparison_page.comparison_page", lambda *_, **__: "")
