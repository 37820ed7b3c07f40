"""What is no readable file is refused with a sentence by everything that takes a file."""

import contextlib
import os
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import qp_twist as qt
from qp_twist.cli import main
from qp_twist.files import write_atomically
from qp_twist.paths import read_toolpath, shipped_folder
from qp_twist.trajectories import read_trajectory

PLANAR = (shipped_folder("tasks") / "planar_line.toml").read_text("utf-8")


def scene_of(file: Path) -> Any:
    task = file.parent / "of a scene.toml"
    task.write_text(PLANAR.replace("../scenes/planar_3r.xml", file.name), "utf-8")
    return qt.load_task(task)


READERS: dict[str, tuple[Callable[[Path], Any], str]] = {
    "task": (qt.load_task, "toml"), "scene": (scene_of, "xml"), "robot": (qt.load_robot, "urdf"),
    "toolpath": (read_toolpath, "csv"),
    "toolpath of a task": (lambda file: qt.load_task("deburring", path=file), "csv"),
    "trajectory": (read_trajectory, "csv"), "trajectory in JSON": (read_trajectory, "json"),
    "trajectory of NumPy": (read_trajectory, "npz"),
}  # fmt: skip


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


LINKS = """<robot name="r"><link name="a"><collision><geometry><box size=".1 .1 .1"/></geometry>
</collision>{more}</link><link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"
ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j" type="revolute"><parent link="a"/>
<child link="b"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>"""
VISUAL = LINKS.format(more='<visual><geometry><mesh filename="{name}"/></geometry></visual>')
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"
NAMED: dict[str, tuple[str, str, str]] = {
    # Name and text of the robot; the file that it leads to, and does without.
    "visual mesh": ("r.urdf", VISUAL.format(name="x.stl"), "x.stl"),
    "visual DAE": ("r.urdf", VISUAL.format(name="x.dae"), "x.dae"),
    "collision mesh": (
        "r.urdf", VISUAL.format(name="x.stl").replace("visual", "collision"), "x.stl"
    ),
    "material of a mesh": ("r.urdf", VISUAL.format(name="m.obj"), "x.mtl"),
    "package": ("r.urdf", VISUAL.format(name="package://p/x.stl"), "package.xml"),
}  # fmt: skip
"""Robots that lead to another file."""


@pytest.mark.parametrize("kind", ["pipe", "device", "huge"])
@pytest.mark.parametrize("named", NAMED)
def test_a_robot_does_not_lead_to_what_is_no_file(named: str, kind: str, tmp_path: Path) -> None:
    name, text, leads_to = NAMED[named]
    (tmp_path / "m.obj").write_text(f"mtllib x.mtl\nusemtl m\n{TETRAHEDRON}")
    (tmp_path / name).write_text(text)
    KINDS[kind][0](tmp_path / leads_to)
    with no_endless_wait(tmp_path / leads_to):
        robot = qt.load_robot(tmp_path / name)
    assert robot.model.njnt == 1


@pytest.mark.parametrize("umask", [0o022, 0o077, 0o002])
def test_new_files_have_the_permissions_that_the_umask_leaves(umask: int, tmp_path: Path) -> None:
    before = os.umask(umask)
    try:
        file = write_atomically(tmp_path / "new" / "a.txt", "text")
        assert file.stat().st_mode & 0o777 == 0o666 & ~umask
        for kept in (0o600, 0o640, 0o755):
            file.chmod(kept)
            write_atomically(file, "more text")
            assert file.stat().st_mode & 0o777 == kept
    finally:
        os.umask(before)


def test_after_a_failure_an_older_file_is_there_and_no_temporary_one(tmp_path: Path) -> None:
    file = write_atomically(tmp_path / "a.txt", "older")
    with pytest.raises(TypeError):
        write_atomically(file, 3)  # type: ignore[arg-type]
    assert [(each.name, each.read_text()) for each in tmp_path.iterdir()] == [("a.txt", "older")]


def test_a_task_whose_name_is_no_utf_8_is_run_checked_and_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    task, out = (os.fsdecode(name) for name in (b"bad\xff.toml", b"o\xff"))
    try:
        Path(task).write_text(PLANAR.replace("../scenes/", ""), "utf-8")
    except OSError:
        pytest.skip("this file system has names in UTF-8 only")
    for ending in ("csv", "json", "npz"):
        main(["run", f"./{task}", "--out", f"{out}.{ending}", "--quiet"])
        main(["check", f"{out}.{ending}", f"./{task}", "--quiet"])
        # The name in the file is that of the task: no note on another one.
        assert qt.load_task(f"./{task}").name in str(
            read_trajectory(f"{out}.{ending}").metadata["task"]
        )
    main(["compare", f"./{task}", "--methods", "qp", "--out", out, "--quiet"])
    assert (Path(out) / "comparison.json").exists()
    assert capsys.readouterr().err == ""
