"""A test that is skipped does not go unseen where everything has to be there."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

FILES = {
    "module": 'import pytest\npytest.importorskip("nosuch", reason="nosuch is missing")',
    "function": 'import pytest\ndef test_it():\n    pytest.skip("nosuch is missing")',
    "mark": 'import pytest\n@pytest.mark.skipif(True, reason="nosuch is missing")\n'
    "def test_it(): pass",
    "expected failure": "import pytest\n@pytest.mark.xfail\ndef test_it(): assert False",
}


@pytest.mark.parametrize(
    ("processes", "allowed", "named"),
    [
        ("-n0", None, ""),
        ("-n0", "browser NoSuch", ""),
        ("-n0", "", "nosuch is missing"),
        ("-n2", "browser", "nosuch is missing"),
    ],
)
def test_only_what_may_be_missing_is_skipped(
    processes: str, allowed: str | None, named: str, tmp_path: Path
) -> None:
    for kind, text in FILES.items():
        (tmp_path / f"test_{kind.replace(' ', '_')}.py").write_text(text)
    (tmp_path / "conftest.py").write_text("from skips import *\n")
    (tmp_path / "pytest.ini").write_text(f"[pytest]\npythonpath = {Path(__file__).parents[1]}\n")
    inherited = {k: v for k, v in os.environ.items() if not k.startswith(("QP_TWIST", "PYTEST"))}
    done = subprocess.run(
        [
            *(sys.executable, "-m", "pytest", processes, "-p", "no:cacheprovider"),
            "--continue-on-collection-errors", "-rN",
        ],
        cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False,
        env=inherited | ({} if allowed is None else {"QP_TWIST_MAY_SKIP": allowed}),
    )  # fmt: skip
    last = done.stdout.splitlines()[-1]
    if not named:
        assert done.returncode == 0
        assert "3 skipped, 1 xfailed" in last
        return
    assert done.returncode == 1
    assert "1 failed, 1 xfailed, 2 errors" in last
    assert done.stdout.count(f"{named}\nOnly what has one of these words") == 3
