"""A gripper whose fingers the scene couples: steps, runs, plans and checks keep them together."""

import dataclasses

import mink
import mujoco
import numpy as np

import qp_twist as qt

SLIDE = mujoco.mjtJoint.mjJNT_SLIDE


def with_gripper(file):
    """The scene of a file, with two fingers beside its tool, one of which mirrors the other."""
    spec = mujoco.MjSpec.from_file(str(file))
    hand = spec.site("tool").parent
    for name, side in (("finger_1", 1), ("finger_2", -1)):
        finger = hand.add_body(name=name)
        finger.add_joint(name=name, type=SLIDE, axis=[0, side, 0], range=[0, 0.04])
        finger.add_geom(size=[0.01, 0, 0], contype=0, conaffinity=0)
    coupling = spec.add_equality(
        type=mujoco.mjtEq.mjEQ_JOINT,
        objtype=mujoco.mjtObj.mjOBJ_JOINT,
        name1="finger_2",
        name2="finger_1",
    )
    coupling.data[:5] = [0, 1, 0, 0, 0]  # finger_2 = finger_1
    return spec.compile()


if __name__ == "__main__":
    arm = qt.load_task("deburring")
    task = dataclasses.replace(
        arm,
        model=with_gripper(arm.scene),
        start=np.append(arm.start, [0.01, 0.01]),
        velocity_limits=np.append(arm.velocity_limits, [0.1, 0.1]),
        acceleration_limits=np.append(arm.acceleration_limits, [np.inf, np.inf]),
    )
    print("kept on the path:", task.constraints)

    twist = qt.TwistTask("tool", "site", task.projector)
    twist.set_target(task.waypoints[1])
    apart = qt.PostureReference(task.model, np.append(arm.start, [0.03, 0.0]))
    configuration = mink.Configuration(task.model, task.start)
    for name, limits in (("limits given", [qt.PositionLimit(task.model)]), ("not given", None)):
        controller = qt.Controller(task.model, [twist], secondary=[apart], limits=limits)
        step = controller.step(configuration, 0.5)
        print(f"fingers, {name}: {step.velocity[6:].round(4)} m/s")

    run = qt.follow(task, "qp_gradient")
    torn = run.q + np.outer(np.linspace(0, 1, len(run.q)), [0, 0, 0, 0, 0, 0, 0.002, 0])
    for name, moved in (("the run", run), ("torn apart", dataclasses.replace(run, q=torn))):
        print(f"{name}:")
        for finding in qt.check_trajectory(moved, task).findings:
            if "coupling" in finding.name:
                print(" ", finding)

    few = dataclasses.replace(
        task, waypoints=task.waypoints[::10], flipped_waypoints=None, durations=None
    )
    plan = qt.plan(few)
    print(plan)
    print(f"fingers apart by at most {1e3 * abs(plan.q[:, 7] - plan.q[:, 6]).max():.6f} mm")
