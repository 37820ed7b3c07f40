"""Machine code is kept for exactly the sources that it was made from.

In copies of the package's folder of kernels, each with its own cache, so that nothing is compiled
but two functions of a line each and one small kernel.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import qp_twist

pytestmark = pytest.mark.any_blas

KERNEL = Path(qp_twist.__file__).parent / "kernel"
INNER = """
from qp_twist.kernel.compiling import plain
FACTOR = 2.0
@plain
def scaled(x):
    return FACTOR * x
"""
OUTER = """
from qp_twist.kernel.compiling import entry
from qp_twist.kernel.inner import scaled
@entry
def shifted(x):
    return scaled(x) + 1.0
"""
CALL = """
from qp_twist.kernel.outer import shifted
print(shifted(10.0), sum(shifted.stats.cache_hits.values()))
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package of two kernels, one of which calls the other, which lies in another file."""
    folder = tmp_path / "qp_twist" / "kernel"
    folder.mkdir(parents=True)
    (tmp_path / "qp_twist" / "__init__.py").touch()
    for name in ("__init__", "compiling"):
        shutil.copy(KERNEL / f"{name}.py", folder)
    (folder / "inner.py").write_text(INNER)
    (folder / "outer.py").write_text(OUTER)
    return folder


def started(folder: Path, script: str = CALL, **variables: str) -> subprocess.Popen[str]:
    # Without Python's own cache, which takes two edits within a second for one.
    at_home = {"PYTHONPATH": str(folder.parents[1]), "PYTHONDONTWRITEBYTECODE": "1"}
    kept = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA_")}
    return subprocess.Popen(
        [sys.executable, "-c", script], env=kept | at_home | variables, stdout=subprocess.PIPE,
        text=True, cwd=folder.parents[1],
    )  # fmt: skip


def printed(process: subprocess.Popen[str]) -> list[float]:
    out, _ = process.communicate(timeout=300)
    assert process.returncode == 0
    return [float(word) for word in out.split()]


def run(folder: Path, script: str = CALL, **variables: str) -> list[float]:
    """What a new process prints: here the result, and how often it found machine code."""
    return printed(started(folder, script, **variables))


def kept(folder: Path) -> list[str]:
    return sorted(str(file) for file in folder.rglob("*.nb[ic]"))


def test_an_edit_of_a_kernel_reaches_the_kernels_that_call_it(package: Path) -> None:
    assert run(package) == [21.0, 0]
    first = kept(package)
    assert run(package) == [21.0, 1]  # nothing changed: the machine code of before
    (package / "inner.py").write_text(INNER.replace("2.0", "3.0"))
    assert run(package) == [31.0, 0]
    # Nothing piles up: the files of the former sources are gone.
    assert len(kept(package)) == len(first) and not set(kept(package)) & set(first)
    (package / "inner.py").write_text(INNER)
    assert run(package)[0] == 21.0


def test_processes_that_compile_at_once_do_not_disturb_each_other(package: Path) -> None:
    together = [started(package) for _ in range(4)]
    done = [printed(process) for process in together]
    assert [result for result, _ in done] == [21.0] * 4
    # One of them compiled, the others waited for it and loaded.
    assert sorted(hits for _, hits in done) == [0, 1, 1, 1]
    assert run(package) == [21.0, 1]


def test_beside_sources_that_are_read_only_the_cache_lies_in_the_users_folder(
    package: Path, tmp_path: Path
) -> None:
    (package / "__pycache__").touch()  # a file where the folder would be: nobody can write into it
    home = tmp_path / "home"
    for found in (0, 1):
        assert run(package, XDG_CACHE_HOME=str(home), HOME=str(home)) == [21.0, found]
    assert not kept(package) and kept(home)
    asked_for = tmp_path / "asked for"
    assert run(package, NUMBA_CACHE_DIR=str(asked_for)) == [21.0, 0]
    assert kept(asked_for)
    # No folder at all: compiled anew by every process.
    for _ in range(2):
        nowhere = "/dev/null/home"
        assert run(package, XDG_CACHE_HOME=nowhere, HOME=nowhere) == [21.0, 0]


def test_a_damaged_file_is_compiled_again(package: Path) -> None:
    """As after a power cut or a fault of the disk; damaged machine code would give any result."""
    assert run(package) == [21.0, 0]
    files = [Path(file) for file in kept(package)]
    assert len(files) >= 2
    for file, damaged in (
        (files[0], lambda whole: b""),
        (files[1], lambda whole: whole[: len(whole) // 2]),
        (files[0], lambda whole: whole[:-900] + bytes([whole[-900] ^ 4]) + whole[-899:]),
    ):
        file.write_bytes(damaged(file.read_bytes()))
        assert run(package)[0] == 21.0
    assert run(package) == [21.0, 1]


def test_on_a_full_disk_kernels_are_compiled_and_no_partial_file_is_left(package: Path) -> None:
    full = "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))\n"
    assert run(package, full + CALL) == [21.0, 0]
    assert not [file for file in package.rglob("*") if file.suffix in (".nbc", ".tmp")]
    assert [run(package), run(package)] == [[21.0, 0], [21.0, 1]]
