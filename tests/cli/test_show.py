"""``qp-twist show``: what a toolpath file was understood to say, before there is a robot."""

import json
from pathlib import Path

import pytest

from qp_twist.cli import main
from qp_twist.paths import shipped_folder

SEAMS = str(shipped_folder("tasks") / "dome_seams.csv")
LINE = "GOTO/0,0,0\nGOTO/30,0,0\n"


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_a_file_is_shown_in_one_glance_and_as_a_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["show", SEAMS])
    said = capsys.readouterr().out
    assert "2 curves, 122 points, surface normals" in said
    assert "unit: mm, as the file states" in said
    assert "left out: not used: column 'no'." in said
    assert (tmp_path / "out" / "dome_seams_toolpath.html").is_file()
    main(["show", SEAMS, "--out", "seams.png"])
    assert (tmp_path / "seams.png").read_bytes().startswith(b"\x89PNG")


def test_json_is_in_si_units_and_alone(capsys: pytest.CaptureFixture[str]) -> None:
    Path("line.apt").write_text("UNITS/MM\nFEDRAT/600,MMPM\n" + LINE)
    main(["show", "line.apt", "--json"])
    facts = json.loads(capsys.readouterr().out)
    assert facts["length_m"] == pytest.approx(0.03) and facts["time_s"] == pytest.approx(3.0)
    assert facts["lower_m"] == pytest.approx([0.0, 0.0, 0.0])
    assert facts["upper_m"] == pytest.approx([0.03, 0.0, 0.0])
    assert (facts["points"], facts["curves"], facts["axis"]) == (2, 1, True)
    assert facts["assumptions"] == [
        "no tool axis is stated; (0, 0, 1) is taken, as on a machine of three axes."
    ]
    assert facts["passed_over"] == []
    assert (facts["unit"], facts["unit_in_file"]) == ("mm", True)
    assert facts["longest_step_m"] == {"value": pytest.approx(0.03), "line": 4}


def test_what_is_open_is_asked_with_the_option_that_answers_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    Path("line.apt").write_text(LINE)
    with pytest.raises(SystemExit) as ended:
        main(["show", "line.apt"])
    assert ended.value.code == 2
    assert "For qp-twist show: --unit mm, m or inch" in capsys.readouterr().err
    main(["show", "line.apt", "--unit", "inch"])
    assert "extent: 30 × 0 × 0 inch" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["show", "missing.apt"], "missing.apt"),
        (["show", SEAMS, "--out", "seams.jpg"], "expected a file that ends in .html or .png"),
        (["show", SEAMS, "--out", f"{SEAMS}/page.html"], "give another folder"),
        (["show", SEAMS, "--columns", "position=1,2"], "--columns"),
    ],
)
def test_refused_input_is_one_sentence(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    said = capsys.readouterr().err
    assert ended.value.code == 2 and message in said and said.count("\n") == 1
