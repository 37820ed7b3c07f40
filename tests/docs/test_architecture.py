"""The architecture: one-way imports, shipped data, no machine's traces."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def test_imports_go_one_way() -> None:
    command = Path(sys.executable).with_name("lint-imports")
    if not command.exists():
        pytest.skip("import-linter is not installed; pip install -e '.[dev]' brings it.")
    done = subprocess.run(
        [command, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout
    assert "1 kept, 0 broken" in done.stdout


def test_importing_the_package_loads_nothing_heavy_and_every_name_is_there() -> None:
    source = """
import sys
import types
import qp_twist
loaded = {"mujoco", "mink", "scipy", "numpy", "matplotlib"} & set(sys.modules)
assert not loaded, loaded
missing = [name for name in dir(qp_twist) if not hasattr(qp_twist, name)]
assert not missing, missing
assert qp_twist.planning.Plan is qp_twist.Plan
modules = [name for name in dir(qp_twist) if isinstance(getattr(qp_twist, name), types.ModuleType)]
assert not modules, modules
print(len(qp_twist.__all__), "matplotlib" in sys.modules)
"""
    done = subprocess.run(
        [sys.executable, "-c", source], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    count, drawing = done.stdout.split()
    assert int(count) >= 60 and drawing == "False"


def test_no_module_is_called_like_a_data_folder() -> None:
    # The wheel puts tasks/ and scenes/ inside the package.
    assert not (ROOT / "qp_twist" / "tasks").exists()
    assert not (ROOT / "qp_twist" / "scenes").exists()
    assert not (ROOT / "qp_twist" / "tasks.py").exists()
    assert not (ROOT / "qp_twist" / "scenes.py").exists()


def test_the_changelog_knows_this_version() -> None:
    source = (ROOT / "qp_twist" / "__init__.py").read_text("utf-8")
    version = re.search(r'__version__ = "(.+)"', source)
    assert version is not None
    assert f"[{version[1]}]" in (ROOT / "CHANGELOG.md").read_text("utf-8")
    assert f"version: {version[1]}" in (ROOT / "CITATION.cff").read_text("utf-8")


def test_the_readmes_table_is_the_generated_one() -> None:
    readme = (ROOT / "README.md").read_text("utf-8")
    table = readme.split("docs/make_figures.py -->\n")[1].split("<!-- end of table -->")[0]
    assert table == (ROOT / "docs" / "generated" / "benchmarks" / "deburring.md").read_text("utf-8")


def test_ci_runs_the_readmes_own_commands() -> None:
    readme = (ROOT / "README.md").read_text("utf-8")
    commands = re.findall(r"^python3 -m venv .*$", readme, flags=re.MULTILINE)
    assert len(commands) == 2
    assert commands[0].endswith("qp-twist compare deburring --out out/deburring")
    assert commands[1].endswith("pytest")
    assert "python3 -m venv .*pytest$" in (ROOT / ".ci" / "run").read_text("utf-8")


def test_no_hint_searches_the_words_of_an_error() -> None:
    """An error carries what it is about: ``key``, ``line``, ``column``, ``options``."""
    searches = re.compile(
        r"in str\(error\)|str\(error\)\.(?:startswith|endswith|replace|removeprefix)"
        r'|str\(error\)\.partition\("[^\\]|re\.\w+\([^)]*str\(error\)'
        r"|\.(?:sentence|message|verdict)\.(?:startswith|endswith|find|partition)"
    )
    found = [
        f"{file.name}: {line.strip()}"
        for file in sorted((ROOT / "qp_twist").rglob("*.py"))
        for line in file.read_text("utf-8").splitlines()
        if searches.search(line)
    ]
    assert found == []
