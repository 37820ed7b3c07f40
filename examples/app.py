"""The loop that the apps share: in a viewer at real speed, or headless as fast as it goes."""

import argparse
import time
from collections.abc import Callable

import mink
import mujoco.viewer
import numpy as np

import qp_twist as qt

DT = 0.01
_parser = argparse.ArgumentParser()
_parser.add_argument("--headless", action="store_true", help="no window")
_parser.add_argument("--seconds", type=float, help="how long it runs")
_given = _parser.parse_args()
HEADLESS: bool = _given.headless


def off(task: qt.TwistTask, configuration: mink.Configuration) -> float:
    """How far a task is from its target, m and rad together."""
    return float(np.linalg.norm(task.state(configuration).error))


def run(
    configuration: mink.Configuration,
    step: Callable[[float], None],
    lasts: float,
    key: Callable[[int], None] | None = None,
) -> None:
    """Call ``step`` with the time, every 10 ms, for as long as the command line says.

    In a window ``key`` is called with the code of each key that is pressed.
    """
    seconds = lasts if _given.seconds is None else _given.seconds
    times = [k * DT for k in range(round(seconds / DT))]
    if HEADLESS:
        for t in times:
            step(t)
        return
    with mujoco.viewer.launch_passive(
        configuration.model, configuration.data, key_callback=key
    ) as viewer:
        began = time.monotonic()
        for t in times:
            if not viewer.is_running():
                break
            step(t)
            viewer.sync()
            time.sleep(max(0.0, began + t + DT - time.monotonic()))
