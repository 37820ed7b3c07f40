"""From a URDF and a CSV to a task and a run."""

import warnings
from pathlib import Path

import numpy as np

import qp_twist as qt
from qp_twist.cli import main

AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
OFFSETS = ("0 0 0.2", "0.1 0 0.25", "0 0 0.45", "0.25 0 0.03", "0.25 0 0", "0.05 0 0")
RANGES = (2.9, 1.8, 1.5, 3.3, 2.0, 6.0)


def robot(name: str) -> str:
    """A six-axis arm as a URDF."""
    links, joints = '<link name="base"/>', ""
    for number, (axis, offset, limit) in enumerate(zip(AXES, OFFSETS, RANGES, strict=True), 1):
        parent = f"link_{number - 1}" if number > 1 else "base"
        links += f'<link name="link_{number}"/>'
        joints += f"""<joint name="joint_{number}" type="revolute">
          <parent link="{parent}"/><child link="link_{number}"/>
          <origin xyz="{offset}"/><axis xyz="{axis}"/>
          <limit lower="-{limit}" upper="{limit}" velocity="3" effort="0"/></joint>"""
    return f"""<robot name="{name}">{links}<link name="tool0"/>{joints}
      <joint name="flange" type="fixed"><parent link="link_6"/><child link="tool0"/>
      <origin xyz="0.1 0 0" rpy="0 1.5707963267948966 0"/></joint></robot>"""


Path("robot.urdf").write_text(robot("six_axes"))
angle = np.radians(np.linspace(-15, 15, 13))
rows = ["x [mm],y [mm],z [mm],nx,ny,nz"]
rows += [f"550,{300 * np.sin(a):.3f},{300 * np.cos(a):.3f},0,{np.sin(a):.5f},{np.cos(a):.5f}"
         for a in angle]  # fmt: skip
Path("edge.csv").write_text("\n".join(rows))

print("$ qp-twist new robot.urdf --path edge.csv --out edge.toml")
main(["new", "robot.urdf", "--path", "edge.csv", "--out", "edge.toml"])
print("\n$ cat edge.toml")
print(Path("edge.toml").read_text("utf-8"))

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # the arm has no masses
    task = qt.load_task("./edge.toml")
print("$ qp-twist starts ./edge.toml --count 3")
with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    main(["starts", "./edge.toml", "--count", "3"])
run = qt.follow(task, "qp_gradient")
print(f"\nqp_gradient: on the path: {run.position_error.max() < 1e-8}, "
      f"inside the limits: {run.margins.min() > 0}")  # fmt: skip
