"""Which tests are numerical: they run on several kernels of OpenBLAS, too (``.ci/kernels.py``)."""

from pathlib import Path

HERE = Path(__file__).parent
FOLDERS = (
    "geometry", "kinematics", "constraints", "closed_form", "qp", "kernel", "control", "referee",
)  # fmt: skip
"""Folders whose tests are marked ``numerical``. The others are about files, pages, pictures and
commands, or about motions along whole paths, which take minutes and are made of the steps that
these test; a module of theirs that is numerical says so by ``pytestmark``, and a test here that is
not by one of the marks :data:`EXCEPT`."""
EXCEPT = ("whole_path", "any_blas")


def paths() -> list[Path]:
    """The folders, and the modules elsewhere that are numerical: no other has to be imported."""
    modules = [
        file
        for file in sorted(HERE.glob("*/test_*.py"))
        if file.parent.name not in FOLDERS and "pytest.mark.numerical" in file.read_text("utf-8")
    ]
    return [*(HERE / name for name in FOLDERS), *modules]
