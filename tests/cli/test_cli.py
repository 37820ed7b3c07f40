"""The command, as a person types it."""

import importlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from oracles.ball_cell import FEED, ball_before, write_cell

import qp_twist as qt
from qp_twist import PathTask, Trajectory
from qp_twist.cli import main
from qp_twist.cli.command import COMMANDS
from qp_twist.cli.command import command as function_of
from qp_twist.paths import shipped_folder


def test_help_names_every_command_and_what_it_does(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--help"])
    listed = " ".join(capsys.readouterr().out.split())
    for name in COMMANDS:
        first = (function_of(name).__doc__ or "").partition("\n\n")[0]
        assert f" {name} {' '.join(first.split())}" in listed


@pytest.mark.parametrize(
    ("words", "unused"),
    [
        ("--help", {"mink", "mujoco", "numba", "scipy"}),
        ("tasks", {"mink", "mujoco", "numba", "scipy"}),
        ("run planar_line --out FILE", {"scipy.spatial", "scipy.optimize", "glfw"}),
    ],
)
def test_what_is_not_used_is_not_loaded(words: str, unused: set[str], tmp_path: Path) -> None:
    """Each takes a tenth of a second and more, in which whoever types a command waits."""
    given = words.replace("FILE", str(tmp_path / "m.csv")).split()
    source = f"import sys; from qp_twist.cli import main; main({given}); print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", source], capture_output=True, text=True, check=True
    )
    loaded = done.stdout.splitlines()[-1].split()
    assert "tyro" in loaded
    assert not unused & set(loaded)


def test_tasks_lists_every_file_with_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    main(["tasks"])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == [
        "approach_contact_retreat", "deburring", "deburring_bands", "deburring_cell", "dome_seams",
        "part_in_hand", "planar_line", "turn_tilt",
    ]  # fmt: skip
    assert all(len(line.split()) > 5 for line in lines)


@pytest.mark.usefixtures("undrawn")
def test_compare_prints_the_table_and_writes_the_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["compare", "planar_line", "--methods", "qp_gradient,gradient_projection",
          "--solver", "proxqp", "--out", str(tmp_path / "out")])  # fmt: skip
    out, err = capsys.readouterr()
    assert "gradient_projection" in out
    assert "QPs by proxqp" in out
    assert "\x1b[" not in out
    others = [line for line in err.splitlines() if not line.startswith("note: machine code")]
    assert others == []  # that note stands there on a new machine
    content = json.loads((tmp_path / "out" / "comparison.json").read_text("utf-8"))
    assert content["solver"] == "proxqp"
    assert list(content["methods"]) == ["gradient_projection", "qp_gradient"]


def test_run_writes_one_trajectory_and_says_that_it_makes_a_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "not" / "there"
    for note in (f"note: {folder} is not there yet and will be made\n", ""):
        main(["run", "planar_line", "--method", "qp_gradient", "--out", str(folder / "line.csv")])
        out, err = capsys.readouterr()
        assert err == note
        assert f"wrote {folder / 'line.csv'}: 101 waypoints" in out
    assert (folder / "line.csv").read_text("utf-8").count("\n") == 104


def test_run_keeps_the_path_between_the_waypoints_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "line.json"
    main(["run", "planar_line", "--method", "qp", "--out", str(file)])
    out = capsys.readouterr().out
    assert "rows more between waypoints" in out
    assert out.splitlines()[-1].startswith("passes; joint ")
    assert len(json.loads(file.read_text("utf-8"))["points"]) > 101


def test_run_plans_where_the_default_method_does_not_pass(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the ball only x is prescribed: steps end at the box, a plan goes around it."""
    monkeypatch.chdir(tmp_path)
    box, along_x = ball_before("box", (0.0, 0.05), (0.1, 0.2)), "{ line = [1, 0, 0] }"
    write_cell("around", box, -0.5, 0.5, steps=20, linear=along_x, more=FEED)
    main(["run", "around.toml", "--out", "ball.csv"])
    out = capsys.readouterr().out
    assert "21 waypoints, qp_planned:" in out
    assert "\nqp_gradient: does not pass: " in out
    assert out.splitlines()[-1].startswith("passes; ")


def test_a_command_does_not_write_onto_what_it_reads(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    task = qt.load_task("planar_line")
    lines = "\n".join(",".join(map(str, 1e3 * p)) for p in task.positions[::20])
    toolpath = Path("line.csv")
    toolpath.write_text("x_mm,y_mm,z_mm\n" + lines)
    before = toolpath.read_bytes()
    for words, why in (
        (["run", "planar_line", "--path", "line.csv", "--out", "./line.csv"], "reads this file"),
        (["roadmap", "planar_line", "--out", "line.csv"], "ends in .png"),
    ):
        with pytest.raises(SystemExit):
            main(words)
        assert why in capsys.readouterr().err
        assert toolpath.read_bytes() == before
    main(["run", "planar_line", "--out", "line.csv"])  # which only another command has read
    assert toolpath.read_bytes() != before


@pytest.mark.parametrize("task", ["planar_line", "deburring"])
def test_roadmap_draws_one_figure(
    task: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, few = tmp_path / "fig4.png", tmp_path / "few.toml"
    text = (shipped_folder("tasks") / f"{task}.toml").read_text("utf-8").replace("../scenes/", "")
    few.write_text(text.replace(" = 100 ", " = 10 "), "utf-8")  # steps of an edge
    main(["roadmap", str(few), "--methods", "minimum_norm,twa", "--out", str(file), "--json"])
    assert file.read_bytes().startswith(b"\x89PNG")
    found = json.loads(capsys.readouterr().out)  # nothing else on standard output
    assert found["file"] == str(file)
    assert list(found["methods"]) == ["minimum_norm", "twa"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["compare", "nosuch"], "no shipped task 'nosuch'"),
        (["compare", "planar_line", "--methods", "qp,fancy"], "unknown method 'fancy'"),
        (["compare", "planar_line", "--solver", "nosuch"], "'nosuch' is not installed"),
        (["run", "planar_line", "--method", "fancy", "--out", "x.csv"], "unknown method 'fancy'"),
        (["run", "planar_line", "--out", "x.xlsx"], "ends in .csv"),
        (["roadmap", "approach_contact_retreat"], "planar arms"),
        (["chek", "x.csv", "deburring"], "no command 'chek'; did you mean 'check'?"),
        (["what"], "no command 'what'. Commands: bench, check,"),
        (["--versoin"], "no command '--versoin'; did you mean '--version'?"),
        (["compare", "deburing"], "no shipped task 'deburing'; did you mean 'deburring'"),
        (
            ["compare", "deburring", "--methods", "qp_gradent"],
            "'qp_gradent'; did you mean 'qp_gradient'?",
        ),
        (["compare", "deburring", "--solver", "dapq"], "; did you mean 'daqp'?"),
        (["study", "planar_line", "--vary", "placment"], "'placment'; did you mean 'placement'?"),
        (["study", "planar_line", "--jobs", "0"], "jobs: expected 1 process or more, got 0; give"),
        (["place", "planar_line", "--jobs", "0"], "jobs: expected 1 process or more, got 0; give"),
        (["place", "planar_line", "--jobs", "-2"], "1 process or more, got -2; give another"),
    ],
)
def test_refused_input_is_one_sentence_and_exit_code_2(
    arguments: list[str],
    sentence: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    out, err = capsys.readouterr()
    assert sentence in err
    assert err.startswith("qp-twist: ")
    assert out == ""
    assert list(tmp_path.iterdir()) == []


def test_a_misspelled_option_is_refused_with_a_suggestion(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["run", "deburring", "--out", "x.csv", "--mehtod", "qp"])
    assert caught.value.code == 2
    out, err = capsys.readouterr()
    assert out == "" and "--mehtod" in err and "--method" in err


class Output(io.TextIOWrapper):
    """Standard output as Python opens it, at a file descriptor; unbuffered as with ``-u``."""

    def __init__(self, descriptor: int, *, buffered: bool) -> None:
        binary = os.fdopen(descriptor, "wb", buffering=-1 if buffered else 0)
        super().__init__(binary, encoding="utf-8", write_through=not buffered)


@pytest.mark.parametrize(
    ("arguments", "unbuffered"), [(["--version"], ""), (["--version"], "1"), (["tasks"], "")]
)
def test_a_process_whose_output_nobody_reads_ends_without_a_word(
    arguments: list[str], unbuffered: str
) -> None:
    """Python's own end, where it writes what is left in a buffer, included."""
    reader, writer = os.pipe()
    os.close(reader)
    ended = subprocess.run(
        [sys.executable, "-m", "qp_twist", *arguments], stdout=writer, stderr=subprocess.PIPE,
        timeout=300, env=os.environ | {"PYTHONUNBUFFERED": unbuffered}, check=False,
    )  # fmt: skip
    os.close(writer)
    assert (ended.returncode, ended.stderr) == (141, b"")


@pytest.mark.parametrize("buffered", [True, False])
def test_output_that_does_not_fit_on_the_disk_is_one_sentence(
    buffered: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("this system has no /dev/full")
    with Output(os.open("/dev/full", os.O_WRONLY), buffered=buffered) as output:
        monkeypatch.setattr(sys, "stdout", output)
        with pytest.raises(SystemExit) as ended:
            main(["tasks"])
    assert ended.value.code == 2
    assert capsys.readouterr().err == "qp-twist: [Errno 28] No space left on device\n"


@pytest.mark.usefixtures("without_picture")
def test_run_writes_the_page_that_report_writes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, pages = str(tmp_path / "x.npz"), []
    main(["run", "planar_line", "--out", file, "--report", str(tmp_path / "run")])
    assert f"wrote {tmp_path / 'run' / 'report.html'}" in capsys.readouterr().out
    main(["report", file, "planar_line", "--out", str(tmp_path / "report")])
    for name in ("run", "report"):
        page = (tmp_path / name / "report.html").read_text("utf-8")
        # But for the time at which it is written, and what viser counts.
        page = re.sub(r"<dt>Date</dt><dd>.*?</dd>", "", page)
        pages.append(re.sub(r'class="recording"[^>]*>.*?<', "", page))
    assert pages[0] == pages[1]
    with pytest.raises(SystemExit):
        main(["run", "planar_line", "--out", file, "--report", str(tmp_path / "page.html")])
    assert "page.html: expected a folder" in capsys.readouterr().err
    assert not (tmp_path / "page.html").exists()


def test_brackets_in_a_path_are_no_markup(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "o[bold]" / "a[/b].csv"
    main(["run", "planar_line", "--out", str(file)])
    assert f"wrote {file}: 101" in capsys.readouterr().out
    assert file.exists()


def test_ctrl_c_while_the_command_is_still_loading_is_a_sentence() -> None:
    source = """
import sys

class Interrupting:
    def find_spec(self, name, *rest):
        if name == "mujoco":
            raise KeyboardInterrupt

sys.meta_path.insert(0, Interrupting())
from qp_twist.cli import main
main(["starts", "planar_line"])
"""
    done = subprocess.run(
        [sys.executable, "-c", source], capture_output=True, text=True, check=False
    )
    assert done.returncode == 130
    assert done.stdout == ""
    assert done.stderr == "qp-twist: interrupted; files that were written before are whole.\n"


@pytest.mark.parametrize("name", ["missing/x.csv", "folder.csv"])
def test_run_refuses_a_file_it_cannot_write_before_it_begins(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "missing").write_text("a file, no folder")
    (tmp_path / "folder.csv").mkdir()
    monkeypatch.setattr("qp_twist.cli.run.run_task", None)  # a call would fail
    with pytest.raises(SystemExit) as ended:
        main(["run", "planar_line", "--out", str(tmp_path / name)])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert said.startswith(f"qp-twist: --out {tmp_path / name}: ")
    assert said.rstrip().endswith(("give a file to write.", "give another folder."))


def test_ctrl_c_leaves_the_methods_that_are_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # The package has a function of this name.
    module = importlib.import_module("qp_twist.comparison.compare")
    follow = module.follow

    def interrupted(task: PathTask, method: str, **options: Any) -> Trajectory:
        if method == "twa":
            raise KeyboardInterrupt
        return follow(task, method, **options)

    monkeypatch.setattr(module, "follow", interrupted)
    with pytest.raises(SystemExit) as caught:
        main(["compare", "planar_line", "--methods", "twa,minimum_norm,qp", "--out", str(tmp_path)])
    assert caught.value.code == 130
    out, err = capsys.readouterr()
    assert "interrupted" in err
    assert "interrupted: this is what 1 of 3 methods came to" in out
    assert f"wrote {tmp_path / 'comparison.json'}" in out
    content = json.loads((tmp_path / "comparison.json").read_text("utf-8"))
    assert list(content["methods"]) == ["minimum_norm"]
    assert content["not_run"] == {"twa": "interrupted", "qp": "interrupted"}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["comparison.json", "table.txt"]


def test_ctrl_c_in_a_study_says_what_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module = importlib.import_module("qp_twist.cli.study")
    run = module.run_study

    def stopped(*arguments: Any, **options: Any) -> None:
        def interrupt(done: int) -> None:
            if done == 2:
                raise KeyboardInterrupt

        run(*arguments, **{**options, "progress": interrupt})

    monkeypatch.setattr(module, "run_study", stopped)
    words = ["study", "planar_line", "--samples", "5", "--methods", "qp_minimum_norm"]
    with pytest.raises(SystemExit) as caught:
        main([*words, "--no-certify", "--jobs", "1", "--out", str(tmp_path / "out")])
    assert caught.value.code == 130
    said = " ".join(capsys.readouterr().out.split())
    assert "2 of 5 samples" in said
    assert "interrupted: 2 of 5 samples are kept in" in said
    assert "the same command goes on from there" in said
    assert len(qt.studies.Study.open(tmp_path / "out").missing()) == 3


def test_run_says_what_went_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["run", "planar_line", "--method", "twa", "--out", str(tmp_path / "x.csv"), "--quiet"])
    assert caught.value.code == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert "does not pass" in err
    assert "smallest joint margin" in err
    assert (tmp_path / "x.csv").exists()


def test_a_terminal_without_greek_letters_gets_the_table_all_the_same(tmp_path: Path) -> None:
    words = ["compare", "planar_line", "--methods", "twa", "--out", str(tmp_path)]
    undrawn = "import qp_twist as qt; qt.Comparison.figures = lambda _: {}; "  # not looked at here
    done = subprocess.run(
        [sys.executable, "-c", f"{undrawn}from qp_twist.cli import main; main({words})"],
        capture_output=True, check=False,
        env={**os.environ, "PYTHONUTF8": "0", "PYTHONIOENCODING": "ascii", "LC_ALL": "C"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert b"joint_2 at 2" in done.stdout
    assert "½‖W(θ̄ − θ)‖²" in (tmp_path / "table.txt").read_text("utf-8")


def test_tasks_and_starts_print_json_and_nothing_else(capsys: pytest.CaptureFixture[str]) -> None:
    main(["tasks", "--json"])
    listed = json.loads(capsys.readouterr().out)
    assert "planar_line" in {task["task"] for task in listed}
    assert all(Path(task["file"]).is_file() and task["title"] for task in listed)
    main(["starts", "planar_line", "--count", "1", "--json"])
    [start] = json.loads(capsys.readouterr().out)
    task = qt.load_task("planar_line")
    data = mujoco.MjData(task.model)
    data.qpos[:] = list(start["q"].values())
    mujoco.mj_kinematics(task.model, data)
    reached = getattr(data, task.frame_type)(task.frame_name).xpos
    assert list(start["q"]) == ["joint_1", "joint_2", "joint_3"]
    assert np.linalg.norm((reached - task.positions[0])[:2]) < 1e-5
    assert start["completed"] and start["reached"] == len(task.waypoints)


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_a_shell_gets_a_script_that_completes_commands(shell: str, tmp_path: Path) -> None:
    script = tmp_path / "completion"
    done = subprocess.run(
        [sys.executable, "-m", "qp_twist", "--tyro-print-completion", shell],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    script.write_text(done.stdout)
    if shell == "zsh":
        assert done.stdout.startswith("#compdef qp-twist\n")
        assert "'check': {" in done.stdout
    found = shutil.which(shell)
    if found is not None:  # bash is everywhere, zsh is not
        subprocess.run([found, "-n", str(script)], check=True)
    if shell == "bash":
        assert found is not None
        ask = f"source {script}; COMP_WORDS=(qp-twist che); COMP_CWORD=1; "
        ask += "$(complete -p qp-twist | sed 's/.*-F \\([^ ]*\\).*/\\1/'); echo ${COMPREPLY[@]}"
        said = subprocess.run([found, "-c", ask], capture_output=True, text=True, check=True)
        assert said.stdout.split() == ["check"]


@pytest.mark.parametrize("quiet", [False, True])
def test_a_command_says_once_that_kernels_are_compiled(
    quiet: bool, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a new machine: two functions are compiled anew while the command computes."""
    import numba

    from qp_twist.cli import tasks as module
    from qp_twist.cli.path_tasks import load

    def computing(task: str) -> list[Path]:
        load(task)
        return [Path(f"{numba.njit(lambda x, k=k: x + k)(1)}.toml") for k in (1, 2)]

    monkeypatch.setattr(module, "shipped_tasks", lambda: computing("planar_line"))
    monkeypatch.setattr(module, "task_title", lambda path: "", raising=False)
    main(["tasks", *(["--quiet"] if quiet else [])])
    told = capsys.readouterr().err
    assert told.count("note: machine code is made, once on a machine") == (0 if quiet else 1)
