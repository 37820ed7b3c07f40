"""The comparison of ``qp-twist compare deburring`` from Python.

    python examples/compare_deburring.py [FOLDER]

Prints the table and writes comparison.json, figures and a picture of the scene into the folder.
"""

import sys

import qp_twist as qt

task = qt.load_task("deburring")
comparison = qt.compare(task)
print(comparison.table())
for line in comparison.report(sys.argv[1] if len(sys.argv) > 1 else "out/deburring"):
    print(line)
