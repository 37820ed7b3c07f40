"""What is no readable file is refused with a sentence by everything that takes a file."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import qp_twist as qt
from qp_twist.bench.record import read_run
from qp_twist.paths import read_toolpath, shipped_folder
from qp_twist.qp import QuadraticProgram
from qp_twist.trajectories import read_trajectory

PLANAR = (shipped_folder("tasks") / "planar_line.toml").read_text("utf-8")


def scene_of(file: Path) -> Any:
    task = file.parent / "of a scene.toml"
    task.write_text(PLANAR.replace("../scenes/planar_3r.xml", file.name), "utf-8")
    return qt.load_task(task)


READERS: dict[str, tuple[Callable[[Path], Any], str]] = {
    "task": (qt.load_task, "toml"),
    "scene": (scene_of, "xml"),
    "robot": (qt.load_robot, "urdf"),
    "toolpath": (read_toolpath, "csv"),
    "toolpath of a task": (lambda file: qt.load_task("deburring", path=file), "csv"),
    "trajectory": (read_trajectory, "csv"),
    "trajectory in JSON": (read_trajectory, "json"),
    "trajectory of NumPy": (read_trajectory, "npz"),
    "program": (QuadraticProgram.load, "npz"),
    "bench": (read_run, "json"),
}


def pipe(file: Path) -> None:
    os.mkfifo(file)


def device(file: Path) -> None:
    file.symlink_to("/dev/null")


def unix_socket(file: Path) -> None:
    # Bound by a short name: that of a socket may have a hundred letters.
    before = Path.cwd()
    os.chdir(file.parent)
    try:
        with socket.socket(socket.AF_UNIX) as opened:
            opened.bind(file.name)
    finally:
        os.chdir(before)


def circle(file: Path) -> None:
    file.symlink_to(file.name)


def huge(file: Path) -> None:
    with file.open("wb") as opened:
        opened.truncate(10**10)  # no block of it is written


def nothing(file: Path) -> None:
    pass


KINDS: dict[str, tuple[Callable[[Path], None], str]] = {
    "pipe": (pipe, "is a pipe, a socket or a device"),
    "device": (device, "is a pipe, a socket or a device"),
    "socket": (unix_socket, "is a pipe, a socket or a device"),
    "folder": (lambda file: file.mkdir(), "is a folder; give the"),
    "links in a circle": (circle, "cannot be read (Too many levels of symbolic links)"),
    "huge": (huge, "has 10000 MB, and at most 500 MB are read"),
    "nothing": (nothing, "there is no "),
}


@contextlib.contextmanager
def no_endless_wait(file: Path) -> Iterator[None]:
    """Whoever waits for a pipe gets an end of file after a while, so that the test fails."""

    def end() -> None:
        with contextlib.suppress(OSError):
            os.close(os.open(file, os.O_WRONLY | os.O_NONBLOCK))

    timer = threading.Timer(5.0, end)
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("reader", READERS)
def test_what_is_no_file_is_refused(reader: str, kind: str, tmp_path: Path) -> None:
    read, ending = READERS[reader]
    make, sentence = KINDS[kind]
    file = tmp_path / f"given.{ending}"
    make(file)
    with no_endless_wait(file), pytest.raises(qt.InvalidInput) as refused:
        read(file)
    assert sentence in str(refused.value)
    assert file.name in str(refused.value)


@pytest.mark.parametrize("reader", READERS)
def test_a_name_that_no_file_can_have_is_refused(reader: str, tmp_path: Path) -> None:
    read, ending = READERS[reader]
    with pytest.raises(qt.InvalidInput):
        read(tmp_path / f"{300 * 'a'}.{ending}")


@pytest.mark.parametrize(("kind", "sentence"), [("pipe", "is a pipe"), ("huge", "has 10000 MB")])
def test_a_mesh_that_cannot_be_read_is_left_out(kind: str, sentence: str, tmp_path: Path) -> None:
    KINDS[kind][0](tmp_path / "hand.stl")
    robot = tmp_path / "robot.urdf"
    robot.write_text(
        """<robot name="r"><link name="a"/><link name="b"><visual><geometry>
        <mesh filename="hand.stl"/></geometry></visual></link>
        <joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint></robot>"""
    )
    with no_endless_wait(tmp_path / "hand.stl"):
        (said,) = [s for s in qt.load_robot(robot).left_out if "hand.stl" in s]
    assert said.startswith("Not readable: ") and sentence in said
