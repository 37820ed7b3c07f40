"""A ball on two slides before a box, as model and as task file: its distance is a formula."""

from collections.abc import Sequence
from pathlib import Path

BALL, DISTANCE = 0.02, 0.01
"""Its radius, and the distance that the task keeps, m."""
FEED = "[feed]\nspeed = 0.1\n[limits.velocity]\nx = 1.0\ny = 1.0\n"


def ball_before(box: str, place: Sequence[float], half: Sequence[float]) -> str:
    """MJCF with a box of a name, its centre and its half sizes along x and y, m."""
    return f"""<mujoco><worldbody>
  <geom name="{box}" type="box" pos="{place[0]} {place[1]} 0" size="{half[0]} {half[1]} 1"/>
  <body><joint name="x" type="slide" axis="1 0 0" range="-2 2"/>
  <geom type="sphere" size="0.001" mass="1" contype="0" conaffinity="0"/>
  <body><joint name="y" type="slide" axis="0 1 0" range="-2 2"/>
  <geom name="ball" type="sphere" size="{BALL}" mass="1"/><site name="tool"/></body></body>
</worldbody></mujoco>"""


def write_cell(
    name: str, model: str, first: float, last: float, steps: int,
    linear: str = '"full"', more: str = "",
) -> None:  # fmt: skip
    """Write ``cell.xml`` and a task file along x into the working directory."""
    Path("cell.xml").write_text(model)
    Path(f"{name}.toml").write_text(f"""title = "A ball before a box"
[robot]
scene = "cell.xml"
frame = "tool"
[projector]
linear = {linear}
angular = "none"
[path]
kind = "polyline"
points = [[{first}, 0, 0], [{last}, 0, 0]]
steps_per_segment = {steps}
[start]
q = [{first}, 0.0]
[clearance]
distance = {DISTANCE}
{more}""")
