"""Settings that all tests share."""

from hypothesis import settings

# The same examples on every machine: a red run can be repeated, a green one means the same.
settings.register_profile("qp_twist", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("qp_twist")
