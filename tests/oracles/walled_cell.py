"""A cell with a wall between two edges, on which an arm works one after the other."""

from pathlib import Path

from qp_twist.paths import shipped_folder

SPEEDS = (2.8798, 2.8798, 3.0543, 6.1087, 5.9341, 9.0757)
"""Largest joint speeds of the arm, rad/s."""
CLEARANCE = 0.005
"""m."""


def walled_task(folder: Path, *, height: float = 0.75, width: float = 0.35) -> Path:
    """Write the task file, its scene and its toolpath.

    Args:
        folder: Where to.
        height: Of the wall's upper edge, m.
        width: Half the length of the wall, m.
    """
    arm = shipped_folder("scenes") / "m16ib_deburring.xml"
    (folder / "wall.xml").write_text(
        f"""<mujoco model="wall">
  <include file="{arm.resolve()}"/>
  <default><geom contype="1" conaffinity="1"/></default>
  <worldbody>
    <body name="wall">
      <geom name="wall" type="box" size="0.03 {width} {height / 2}" pos="0 1 {height / 2}"/>
    </body>
  </worldbody>
</mujoco>""",
        "utf-8",
    )
    (folder / "edges.csv").write_text(
        "curve,x [m],y [m],z [m],i,j,k\n"
        "left,-0.35,1.0,0.42,0,0,1\nleft,-0.25,1.0,0.42,0,0,1\n"
        "right,0.25,1.0,0.42,0,0,1\nright,0.35,1.0,0.42,0,0,1\n"
    )
    speeds = "\n".join(f"joint_{k} = {speed}" for k, speed in enumerate(SPEEDS, start=1))
    file = folder / "wall.toml"
    file.write_text(f"""start = "central"
title = "Two edges on either side of a wall"
[robot]
scene = "wall.xml"
frame = "tool"
[projector]
linear = "full"
angular = {{ plane = [0, 0, 1] }}
frame = "body"
[path]
kind = "file"
file = "edges.csv"
[path.approach]
distance = 0.05
steps = 5
[path.retreat]
distance = 0.05
steps = 5
[path.transfer]
motion = "joint"
[feed]
speed = 0.05
[limits.velocity]
{speeds}
[clearance]
distance = {CLEARANCE}
ignore = [["tool", "part"], ["spindle", "part"]]
""")
    return file
