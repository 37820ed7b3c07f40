"""The tables and the figure of docs/bench.md: ``qp-twist bench``, written where the page has them.

    python benchmarks/steps.py [--run FILE] [--quick]

With ``--run`` those of a bench.json that is there already. Without it three minutes.
"""

from __future__ import annotations

import one_thread  # noqa: F401

# isort: split
import argparse
import sys
from pathlib import Path

from qp_twist.bench import bench, read_run
from qp_twist.bench.figure import draw
from qp_twist.bench.tables import document
from qp_twist.files import write_atomically

DOCS = Path(__file__).resolve().parents[1] / "docs"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--run", type=Path, help="bench.json to take")
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    run = bench(quick=given.quick) if given.run is None else read_run(given.run)
    print(write_atomically(DOCS / "generated" / "bench.md", document(run)))
    print(draw(run, DOCS / "figures" / "bench.svg"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
