"""What all tests share: settings, and the two comparisons that many of them look at."""

import pytest
from hypothesis import settings

import qp_twist as qt

# The same examples on every machine: a red run can be repeated, a green one means the same.
settings.register_profile("qp_twist", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("qp_twist")


@pytest.fixture(scope="session")
def deburring() -> qt.Comparison:
    """Every method on the deburring lap."""
    return qt.compare("deburring")


@pytest.fixture(scope="session")
def planar() -> qt.Comparison:
    """Every method on the planar line."""
    return qt.compare("planar_line")
