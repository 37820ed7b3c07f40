"""``qp-twist bench``."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from qp_twist.cli import app as cli
from qp_twist.errors import InvalidInput

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "bench.py"
"""In a checkout of the repository; a wheel does not have it."""


@cli.command
def bench(
    out: cli.OptionalFile = None,
    quick: cli.Flag = False,
    only: cli.Names = None,
    compare: cli.OptionalFile = None,
) -> None:
    """Time steps of this package, mink, pink and PlaCo, and measure their errors; print tables.

    Runs benchmarks/bench.py of the repository's checkout, which has further options. About three
    minutes, with --quick half a minute; run nothing else meanwhile.

    Args:
        out: JSON file to write all numbers to.
        quick: Time only a few steps.
        only: Contenders by name, or by family (step, mink, placo …), separated by commas.
        compare: File of an earlier run; ratios to it are printed.
    """
    if not SCRIPT.exists():
        raise InvalidInput(
            "bench: its problems and contenders are in the folder benchmarks of the repository, "
            "and this is an installation without it; in a checkout run python benchmarks/bench.py."
        )
    if out is not None:
        cli.check_file(out)
    given = {"--out": out, "--only": only, "--compare": compare}
    words = [str(word) for pair in given.items() if pair[1] is not None for word in pair]
    words += ["--quick"] if quick else []
    sys.stdout.flush()
    raise SystemExit(subprocess.run([sys.executable, str(SCRIPT), *words], check=False).returncode)
