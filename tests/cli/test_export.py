"""``qp-twist export``, and programs in ``run`` and ``check``."""

import json
from pathlib import Path

import pytest

from qp_twist import load_task
from qp_twist.cli import main
from qp_twist.robots import known_robots


@pytest.fixture(scope="module")
def way(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("way") / "way.csv"
    main(["run", "deburring", "--out", str(path), "--quiet"])
    return path


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    with pytest.raises(SystemExit) as end:
        main(list(words))
    assert end.value.code == 2
    return capsys.readouterr().err


def test_export_check_and_json(
    way: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["export", str(way), "deburring", "--to", "ls"])
    said = capsys.readouterr().out
    assert "J3 = joint_3 - J2" in said
    assert "no controller has run it" in said
    assert "joints as the Fanuc M-16iB/20 counts them (Fanuc M-16iB maintenance manual" in said
    main(["check", str(way.with_suffix(".ls")), "deburring"])
    assert "passes" in capsys.readouterr().out
    bag = tmp_path / "way.mcap"
    main(["export", str(way), "deburring", "--out", str(bag), "--json", "--quiet"])
    found = json.loads(capsys.readouterr().out)
    assert found["check"]["passes"]
    assert found["axes"] == []
    main(["export", str(way), "--out", str(tmp_path / "way.ls"), "--robot", "M-16iB/20", "--json"])
    found = json.loads(capsys.readouterr().out)  # nothing else on standard output
    assert found["axes"][2] == "J3 = joint_3 - J2"
    assert found["check"] is None
    program = tmp_path / "new" / "way.ls"
    main(["run", "deburring", "--out", str(program), "--json"])
    found = json.loads(capsys.readouterr().out)
    assert found["file"] == str(program)
    assert found["check"]["passes"]
    assert found["seconds_at_feed"] == pytest.approx(20.78, abs=0.01)
    # From rest to rest, and slower in three corners.
    assert 1.0 < found["seconds"] / found["seconds_at_feed"] < 1.02
    assert program.read_text() == way.with_suffix(".ls").read_text()


def test_without_a_task_the_robot_is_named(
    way: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "which robot it is has to be said" in refused(capsys, "export", str(way), "--to", "krl")
    out = tmp_path / "way.ls"
    main(["export", str(way), "--robot", "Fanuc M-16iB/20", "--out", str(out)])
    assert "not checked: no task given" in capsys.readouterr().out
    main(["check", str(out), "deburring"])
    assert "not those of the KUKA KR 16-2" in refused(
        capsys, "export", str(way), "deburring", "--to", "krl", "--robot", "KR 16-2"
    )


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--to", "krll"), "--to: expected one of urscript, rapid"),
        ((), "say what to write: --to urscript|rapid|krl|ls|mcap"),
        (("--out", "a.txt"), "expected a file that ends in .script"),
        (("--out", "a.src", "--to", "ls"), "a file that ends in .ls, for --to ls"),
        (
            ("--to", "krl"),
            "--to krl: the Fanuc M-16iB/20 is programmed in ls, not in krl; use "
            "--to ls, or say that joints count as in the model (--as-modelled)",
        ),
        (
            ("--out", "a.src"),
            "a.src: the Fanuc M-16iB/20 is programmed in ls, not in krl; choose a "
            "file that ends in .ls, or",
        ),
        (("--to", "mcap", "--as-modelled"), "a bag has the model's joints"),
        (("--to", "ls", "--as-modelled", "--robot", "M-16iB/20"), "but not both"),
        (("--to", "ls", "--as-modelled"), "show J3 as the angle of the forearm to the floor"),
        (("--to", "mcap", "--force"), "--force are for programs"),
        (("--to", "ls", "--robot", "UR5"), "not those of the Universal Robots UR5"),
        (("--to", "ls", "--robot", "no.toml"), "there is no such table of robots"),
        (
            ("--out", "my-way.ls"),
            "qp-twist: my-way.ls: the file's name is the program's, and a TP "
            "program takes a letter, then letters, digits and _",
        ),
    ],
)
def test_requests_that_are_refused(
    words: tuple[str, ...], sentence: str, way: Path, capsys: pytest.CaptureFixture[str],
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert sentence in refused(capsys, "export", str(way), "deburring", *words)
    assert not list(tmp_path.iterdir())


def test_programs_are_refused_before_the_path_is_followed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refused(capsys, "run", "planar_line", "--out", str(tmp_path / "a.src"))
    assert "not one of the known robots" in line
    line = refused(capsys, "run", "deburring", "--out", str(tmp_path / "1.ls"))
    assert "takes a letter" in line
    line = refused(capsys, "run", "deburring", "--out", str(tmp_path / "a.csv"), "--as-modelled")
    assert "are for programs" in line


def test_a_changed_program_does_not_pass(
    way: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["export", str(way), "deburring", "--to", "ls", "--quiet"])
    text = way.with_suffix(".ls").read_text()
    path = tmp_path / "way.ls"
    path.write_text(text.replace("J1= 1", "J1= -1", 1))
    with pytest.raises(SystemExit) as end:
        main(["check", str(path), "deburring", "--quiet"])
    assert end.value.code == 1
    path.write_text(text.replace("!points: 4", "!points: 5"))
    assert "a line was lost or added" in refused(capsys, "check", str(path), "deburring")


@pytest.fixture(scope="module")
def broken(way: Path) -> Path:
    """The trajectory with one row off the path."""
    path = way.with_name("broken.csv")
    lines = way.read_text().split("\n")
    row = len(lines) // 2
    names = next(line for line in lines if "joint_2" in line and not line.startswith("#"))
    column = next(k for k, name in enumerate(names.split(",")) if name.startswith("joint_2"))
    values = lines[row].split(",")
    values[column] = str(float(values[column]) + 0.02)
    path.write_text("\n".join([*lines[:row], ",".join(values), *lines[row + 1 :]]))
    return path


@pytest.mark.parametrize(
    ("program", "suffix"),
    [("urscript", ".script"), ("rapid", ".mod"), ("krl", ".src"), ("ls", ".ls")],
)
def test_a_program_that_does_not_pass_is_not_written(
    program: str, suffix: str, broken: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / f"broken{suffix}"
    words = ["export", str(broken), "deburring", "--out", str(out)]
    words += ["--as-modelled"] if program != "ls" else []
    with pytest.raises(SystemExit) as end:
        main([*words, "--json"])
    assert end.value.code == 1
    assert not list(tmp_path.iterdir())
    printed = capsys.readouterr()
    assert json.loads(printed.out)["written"] is False
    assert "the program is not written" in printed.err
    with pytest.raises(SystemExit) as end:
        main([*words, "--force"])
    assert end.value.code == 1
    assert "a first line that stops a controller" in capsys.readouterr().err
    first, *others = out.read_text().split("\n")
    # No statement of any of the languages, so a controller does not load the file; a script's
    # function, which a controller may take alone from a socket, halts.
    assert first.startswith("DOES NOT PASS ITS CHECK: position error")
    assert first.isascii()
    if program == "urscript":
        start = next(k for k, line in enumerate(others) if line.startswith("def "))
        assert others[start + 1].split()[0] == "halt"
    assert "DOES NOT PASS" in refused(
        capsys, "check", str(out), "deburring", *(["--as-modelled"] if program != "ls" else [])
    )


def test_run_writes_no_program_that_does_not_pass(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    far = tmp_path / "far.csv"
    far.write_text("x_mm,y_mm,z_mm,i,j,k\n900,0,600,0,0,-1\n930,0,600,0,0,-1\n2900,0,600,0,0,-1\n")
    out = tmp_path / "far.ls"
    out.write_text("of an earlier run")
    with pytest.raises(SystemExit) as end:
        main(["run", "deburring", "--path", str(far), "--out", str(out), "--json"])
    assert end.value.code == 1
    printed = capsys.readouterr()
    assert json.loads(printed.out)["written"] is False
    assert "the program is not written" in printed.err
    assert "an older one" in printed.err
    assert out.read_text() == "of an earlier run"


def test_the_task_file_says_how_the_controller_counts(
    way: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = Path(load_task("deburring").source or "").read_text()
    text = text.replace("../scenes/", f"{load_task('deburring').scene.parent}/")
    task = tmp_path / "own.toml"

    def stated(controller: str) -> None:
        task.write_text(text.replace("[robot]", f'[robot]\ncontroller = "{controller}"', 1))

    out = tmp_path / "own.src"
    stated("as modelled")
    main(["export", str(way), str(task), "--out", str(out)])
    assert "joints as the model counts them" in capsys.readouterr().out
    main(["check", str(out), str(task)])  # without an option, as in export
    assert "joints as the model counts them" in capsys.readouterr().out
    main(["report", str(out), str(task), "--out", str(tmp_path / "report")])
    # An option takes the place of what the file states.
    line = refused(capsys, "check", str(out), str(task), "--robot", "M-16iB/20")
    assert "programmed in ls" in line
    stated("UR5")
    assert "not those of the Universal Robots UR5" in refused(
        capsys, "run", str(task), "--out", str(tmp_path / "own.ls")
    )
    stated("UR55")
    assert "there is no robot 'UR55'" in refused(
        capsys, "run", str(task), "--out", str(tmp_path / "own.ls")
    )
    # A table is relative to the task file.
    folder = tmp_path / "tables"
    folder.mkdir()
    known = Path(known_robots.__file__).with_name("known_robots.toml").read_text()
    tables = known.split("[[robot]]")
    mine = next(table for table in tables if "M-16iB/20" in table)
    (folder / "mine.toml").write_text("[[robot]]" + mine.replace("Fanuc M-16iB/20", "My Robot"))
    stated("tables/mine.toml")
    main(["export", str(way), str(task), "--out", str(tmp_path / "own.ls")])
    assert "joints as the My Robot counts them" in capsys.readouterr().out
