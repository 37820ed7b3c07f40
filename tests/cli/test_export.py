"""``qp-twist export``, and programs in ``run`` and ``check``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from qp_twist.cli import main


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
        (("--to", "krll"), "there is no such language"),
        ((), "say what to write: --to urscript|rapid|krl|ls|mcap"),
        (("--out", "a.txt"), "expected a file that ends in .script"),
        (("--out", "a.src", "--to", "ls"), "a file of --to ls ends in .ls"),
        (("--to", "krl"), "programmed in ls, not in krl; choose a file that ends in .ls"),
        (("--to", "mcap", "--as-modelled"), "a bag has the model's joints"),
        (("--to", "ls", "--as-modelled", "--robot", "M-16iB/20"), "but not both"),
        (("--to", "ls", "--robot", "UR5"), "not those of the Universal Robots UR5"),
        (("--to", "ls", "--robot", "no.toml"), "there is no such table of robots"),
        (("--out", "my-way.ls"), "takes a letter, then letters, digits and _"),
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
