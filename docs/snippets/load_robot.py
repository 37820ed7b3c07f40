"""A URDF with what URDFs come with, loaded and moved."""

import tempfile
from pathlib import Path

import mink
import numpy as np

import qp_twist as qt

URDF = """
<robot name="arm">
  <link name="base_link"/>
  <link name="upper_arm">
    <collision><geometry><mesh filename="package://arm/upper_arm.stl"/></geometry></collision>
    <inertial>
      <mass value="2"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <link name="forearm"/>
  <link name="tool0"/>
  <joint name="shoulder" type="revolute">
    <parent link="base_link"/><child link="upper_arm"/><axis xyz="0 0 1"/>
    <limit lower="-2.5" upper="2.5" effort="50" velocity="1.5"/>
  </joint>
  <joint name="elbow" type="continuous">
    <parent link="upper_arm"/><child link="forearm"/><axis xyz="0 0 1"/>
    <origin xyz="0.4 0 0"/><limit effort="50" velocity="3"/>
  </joint>
  <joint name="flange" type="fixed">
    <parent link="forearm"/><child link="tool0"/><origin xyz="0.3 0 0"/>
  </joint>
</robot>
"""

with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "arm.urdf"
    path.write_text(URDF)
    robot = qt.load_robot(path)

print(robot, robot.velocity_limits)
print(*robot.left_out, sep="\n")

along_y = qt.TwistProjector(linear=qt.Projector.line([0, 1, 0]), angular=qt.Projector.none())
task = qt.TwistTask("tool0", "body", along_y)
configuration = mink.Configuration(robot.model)
task.set_target(mink.SE3.from_translation(np.array([0.0, 0.3, 0.0])))
limit = qt.MotionLimit(robot.model, velocity=robot.velocity_limits)
controller = qt.Controller(robot.model, [task], limits=[limit])
for _ in range(20):
    step = controller.step(configuration, dt=0.1)
    configuration.integrate_inplace(step.velocity, 0.1)
tool0 = configuration.get_transform_frame_to_world("tool0", "body")
print(f"tool0 at y = {tool0.translation()[1]:.6f} m")
