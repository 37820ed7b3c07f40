"""From a table in millimetres to joint angles, and what a broken row says."""

from pathlib import Path

import qp_twist as qt

SEAM = """\
no;X [mm];Y [mm];Z [mm];nx;ny;nz
1;0,0;0,0;0,0;0;0;1
2;40,0;0,0;0,0;0;0;1
3;80,0;10,0;0,0;0;0,2;1
"""
Path("seam.csv").write_text(SEAM, encoding="utf-8")
task = qt.load_task("./seam.toml")
print(task)
print(task.toolpath, *task.toolpath.notes)
print(qt.follow(task, "qp_minimum_norm").summary)

for right, wrong in (("40,0;0,0", "40,0;"), ("0,2;1", "0,2"), ("80,0", "80.0")):
    Path("broken.csv").write_text(SEAM.replace(right, wrong), encoding="utf-8")
    try:
        qt.load_task("./seam.toml", path="broken.csv")
    except qt.TaskFileError as error:
        print()
        print(error)
