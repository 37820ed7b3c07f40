"""What a wrong task file says."""

import textwrap
from pathlib import Path

import qp_twist as qt

right = Path("minimal.toml").read_text(encoding="utf-8")
for old, new in (
    ('frame = "tip"', 'fram = "tip"'),
    ("steps_per_segment = 50", 'steps_per_segment = "50"'),
    ('angular = "none"', 'angular = "free"'),
    ('frame = "tip"', 'frame = "flange"'),
    ("q_deg = [70, 70, 100]", "q_deg = [70, 70]"),
    ("[start]", "[limits.velocity]\njoint_1 = 1.0\n\n[start]"),
):
    Path("mine.toml").write_text(right.replace(old, new, 1), encoding="utf-8")
    try:
        qt.load_task("./mine.toml")
    except qt.TaskFileError as error:
        print(new.splitlines()[0])
        print(textwrap.indent(str(error), "    "))
