"""The documentation says what the package does: snippets, tables, keys, names, and the build."""

import importlib
import importlib.util
import inspect
import os
import re
import runpy
import shutil
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from oracles.browser import open_page
from oracles.scripts import script

import qp_twist as qt
from qp_twist.cli import main
from qp_twist.cli.command import COMMANDS
from qp_twist.comparison import metrics
from qp_twist.control.step_settings import SINGULARITY
from qp_twist.kernel.constants import SCALE_BACKOFF
from qp_twist.paths import (
    ColumnChoice,
    ToolpathOptions,
    file_path_schema,
    shipped_tasks,
    task_schema,
)
from qp_twist.paths.methods import METHODS, MethodSettings
from qp_twist.qp import check_solver
from qp_twist.qp.verification import BOUND_TOLERANCE, EQUALITY_TOLERANCE, OPTIMALITY_TOLERANCE

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAPER_LABELS = [
    "t", "inverse", "general", "decomposition", "Mi", "decomposition_t", "twist_decomp", "liguo",
    "z",
]  # fmt: skip


def page(name: str) -> str:
    return (DOCS / name).read_text("utf-8")


def sections(text: str, level: str) -> dict[str, str]:
    """Text below each heading of a level, by the heading without its code marks."""
    parts = re.split(rf"^{level} (.+)$", text, flags=re.MULTILINE)
    return {
        title.replace("`", ""): body for title, body in zip(parts[1::2], parts[2::2], strict=True)
    }


def rows(text: str) -> list[list[str]]:
    """Cells of the Markdown tables in a text, header and rule left out."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    body = [
        line
        for i, line in enumerate(lines)
        if ":-" not in line and ":-" not in "".join(lines[i + 1 : i + 2])
    ]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in body]


def words_and_numbers(text: str) -> tuple[list[str], list[str]]:
    number = r"(?<![\w.])[-−]?\d+\.?\d*(?:e[-+]?\d+)?"
    return re.sub(number, "#", text).split(), re.findall(number, text)


def assert_says_the_same(new: str, kept: str) -> None:
    """Same words; numbers to two units of the last digit, those with an exponent to two decades."""
    words, numbers = words_and_numbers(new)
    kept_words, kept_numbers = words_and_numbers(kept)
    assert words == kept_words
    for a, b in zip(numbers, kept_numbers, strict=True):
        if "e" in a + b:
            assert abs(np.log10(float(a)) - np.log10(float(b))) <= 2.0, (a, b)
        else:
            digits = len(b.partition(".")[2])
            allowed = max(2.0 * 10.0**-digits, 0.003 * abs(float(b)))
            assert float(a) == pytest.approx(float(b), abs=allowed)


@pytest.fixture(scope="module")
def figures() -> ModuleType:
    """docs/make_figures.py as a module."""
    return script("docs", "make_figures.py")


# ---------------------------------------------------------------- snippets


@pytest.mark.parametrize(
    "snippet",
    # The plans of lowest_z are made, and held against the page, in tests/planning/test_plan.py.
    [
        *(p for p in sorted((DOCS / "snippets").glob("*.py")) if p.stem != "lowest_z"),
        ROOT / "examples" / "one_step.py",
    ],
    ids=lambda path: path.stem,
)
def test_a_snippet_prints_what_the_page_shows(snippet: Path, figures: ModuleType) -> None:
    kept = (DOCS / "generated" / "snippets" / f"{snippet.stem}.txt").read_text("utf-8")
    assert_says_the_same(figures.output_of(snippet), kept)


def test_the_example_prints_the_table_and_writes_the_report(
    planar: qt.Comparison,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    # Two methods of another comparison, whose report is made soon; the rest is the script as it is.
    two = {name: planar.trajectories[name] for name in ("twa", "qp_gradient")}
    monkeypatch.setattr(qt, "compare", lambda task: replace(planar, trajectories=two))
    monkeypatch.setattr(sys, "argv", ["compare_deburring.py", str(tmp_path)])
    runpy.run_path(str(ROOT / "examples" / "compare_deburring.py"), run_name="__main__")
    assert "qp_gradient" in capsys.readouterr().out
    assert (tmp_path / "comparison.json").is_file()
    assert (tmp_path / "joints.png").is_file()


def test_the_readme_shows_the_lines_of_the_first_page() -> None:
    lines = (DOCS / "snippets" / "five_lines.py").read_text("utf-8")
    assert lines in (ROOT / "README.md").read_text("utf-8")


# ---------------------------------------------------------------- numbers


def test_the_table_of_the_deburring_example_is_what_compare_gives(
    deburring: qt.Comparison, figures: ModuleType
) -> None:
    kept = (DOCS / "generated" / "benchmarks" / "deburring.md").read_text("utf-8")
    assert_says_the_same(figures.comparison_table(deburring), kept)


def test_the_table_of_the_planar_example_is_what_compare_gives(
    planar: qt.Comparison, figures: ModuleType
) -> None:
    kept = (DOCS / "generated" / "benchmarks" / "planar_line.md").read_text("utf-8")
    assert_says_the_same(figures.comparison_table(planar), kept)


def test_the_table_of_the_cell_is_what_compare_gives(figures: ModuleType) -> None:
    """Of a closed form and a QP: the plan among the other rows takes a minute."""
    kept = (DOCS / "generated" / "benchmarks" / "deburring_cell.md").read_text("utf-8").splitlines()
    made = figures.comparison_table(
        qt.compare("deburring_cell", ["gradient_projection", "qp_gradient"])
    ).splitlines()
    assert made[:2] == kept[:2]
    for line in made[2:]:
        (same,) = (row for row in kept if row.split("|")[1] == line.split("|")[1])
        assert_says_the_same(line, same)
    (row,) = (line for line in kept if "`qp_planned`" in line)
    head = [cell.strip() for cell in kept[0].split("|")]
    clearance = float(row.split("|")[head.index("clearance mm")])
    assert clearance >= 4.9  # as the page says, to 0.1 mm


@pytest.mark.parametrize(
    ("table", "method", "setting"),
    [
        ("deburring_twa", "twa", {"method": "`twa`", "gain": "1.0", "iterations": "1"}),
        ("deburring_twa", "qp", {"method": "`qp`", "gain": "1.0"}),
        ("deburring_gradient", "qp_gradient", {"weight": "natural", "gain": "0.05"}),
        ("planar_line_twa", "twa", {"method": "`twa`", "gain": "1.0"}),
        ("planar_line_twa", "qp", {"method": "`qp`", "gain": "1.0"}),
    ],
)
def test_a_table_of_settings_has_the_shipped_one_in_it(
    table: str,
    method: str,
    setting: dict[str, str],
    figures: ModuleType,
    deburring: qt.Comparison,
    planar: qt.Comparison,
) -> None:
    """The other rows take a minute: docs/make_figures.py writes them all."""
    text = (DOCS / "generated" / "benchmarks" / f"{table}.md").read_text("utf-8")
    head = [cell.strip() for cell in text.splitlines()[0].split("|")[1:-1]]
    [row] = [
        found
        for found in (dict(zip(head, cells, strict=True)) for cells in rows(text))
        if setting.items() <= found.items()
    ]
    comparison = deburring if table.startswith("deburring") else planar
    expected = figures.cells(comparison.trajectories[method])
    shared = [heading for heading in head if heading in expected]
    assert len(shared) >= 4
    for heading in shared:
        assert_says_the_same(expected[heading], row[heading])


def test_numbers_in_the_text_are_those_of_the_runs(
    deburring: qt.Comparison, planar: qt.Comparison
) -> None:
    m = {name: metrics(t) for name, t in deburring.trajectories.items()}
    line = {name: metrics(t) for name, t in planar.trajectories.items()}
    first = m["rmr"]["first_violation"]
    scaled = deburring.trajectories["qp_rmr"].scale < 1.0
    shortest, weighted = (m[n]["travel_deg"] for n in ("minimum_norm", "weighted_least_norm"))
    text = " ".join(page("examples.md").split())
    for sentence in (
        f"joint 4 at waypoint {first['joint_4']}, joint 6 at waypoint {first['joint_6']}",
        f"largest step of `twa`, {m['twa']['max_step_deg']:.1f}°",
        f"with a margin of {m['rmr_flipped']['min_margin']:.3f}",
        f"margin {m['minimum_norm']['min_margin']:.3f} against {m['twa']['min_margin']:.3f}",
        f"mean z ({m['minimum_norm']['mean_z']:.4f} against {m['twa']['mean_z']:.4f})",
        f"reaches its limit at waypoint {int(np.argmax(scaled)) + 1}",
        f"at its largest is {1e3 * m['qp_rmr']['position_error_max_m']:.0f} mm",
        f"scaled at {int(scaled.sum())} waypoints",
        f"largest step of {m['qp']['max_step_deg']:.1f}°",
        f"mean z is {m['qp']['mean_z']:.4f}",
        f"waypoint {line['twa']['first_violation']['joint_2']}, and all three joints",
        f"the {line['minimum_norm']['mean_z']:.4f} of `minimum_norm`",
        f"mean z of {line['qp']['mean_z']:.4f}",
        f"both reach a mean z of {line['qp_gradient']['mean_z']:.4f}",
        f"error of {1e3 * line['gradient_projection']['position_error_max_m']:.2f} mm",
        f"`weighted_least_norm` differs by {weighted - shortest:.0f}° of travel",
    ):
        assert sentence in text
    assert m["twa"]["travel_deg"] > 2.0 * m["minimum_norm"]["travel_deg"]
    assert not m["twa"]["reconfigurations"]
    assert m["sns"]["status"] == "ok"
    # mink, well tuned, is as good as qp_gradient to four digits.
    by_z = sorted((n for n in m if not METHODS[n].peer), key=lambda name: m[name]["mean_z"])
    assert m["mink"]["mean_z"] == pytest.approx(m["qp_gradient"]["mean_z"], rel=1e-3)
    assert by_z[:2] == ["qp_planned", "qp_gradient"]
    assert all(m[name]["violations"] == 0 for name in m if METHODS[name].holds_limits)


def test_shares_of_placements_are_those_of_the_script_and_called_worse_only_where_they_are() -> (
    None
):
    made = {
        r[0]: r
        for r in rows((DOCS / "generated" / "benchmarks" / "placements.md").read_text("utf-8"))
    }
    tuned = {"`mink`, tuned: gain 0.1": "`mink_tuned`", "`twa`, tuned: gain 0.1": "`twa_tuned`",
             "`qp`, gain 1": "`qp`"}  # fmt: skip
    [table] = re.findall(r"\| method \| finishes % .*?\n\n", page("choose.md"), re.DOTALL)
    stated = rows(table)
    assert len(stated) == 10
    for method, first, of_three, _ in stated:
        row = made[tuned.get(method, method)]
        assert (first, of_three) == (row[1], row[3])

    def interval(method: str) -> tuple[float, float]:
        [low, high] = re.findall(r"\(([\d.]+)–([\d.]+)\)", made[f"`{method}`"][1])[0]
        return float(low), float(high)

    alike = ["gradient_projection", "sns", "qp_minimum_norm", "qp_gradient", "mink_tuned"]
    assert max(interval(m)[0] for m in alike) <= min(interval(m)[1] for m in alike)
    for worse in ("minimum_norm", "twa_tuned", "qp"):
        assert interval(worse)[1] < min(interval(m)[0] for m in alike)
    gains = " ".join(
        (DOCS / "generated" / "benchmarks" / "placements_gains.md").read_text("utf-8").split()
    )
    assert "| `qp` | 156 | 157 | 159 | 154 | 144 |" in gains
    assert "finishes 144 at gain 1 and 159 at its best, 0.1" in " ".join(page("choose.md").split())


# ---------------------------------------------------------------- what is listed


SECTIONS = {
    "[robot]": task_schema.RobotSection,
    "[projector]": task_schema.ProjectorSection,
    "[[segments]]": task_schema.SegmentSection,
    '[[bands]] with kind = "roll"': task_schema.RollBandTable,
    '[[bands]] with kind = "cone"': task_schema.ConeBandTable,
    '[[bands]] with kind = "slab"': task_schema.SlabBandTable,
    '[[bands]] with kind = "box"': task_schema.BoxBandTable,
    '[path] with kind = "polyline"': task_schema.PolylinePath,
    '[path] with kind = "spherical_patch"': task_schema.SphericalPatchPath,
    '[path] with kind = "file"': file_path_schema.FilePath,
    "[path.columns]": ColumnChoice,
    "[path.placement]": file_path_schema.WorkpieceTable,
    "[path.approach] and [path.retreat]": file_path_schema.LeadTable,
    "[path.transfer]": file_path_schema.TransferTable,
    '[path] with kind = "poses"': task_schema.PosesPath,
    "[[path.poses]]": task_schema.Pose,
    "[roll]": task_schema.RollSection,
    "[start]": task_schema.StartSection,
    "[feed]": task_schema.FeedSection,
    "[plan]": task_schema.PlanSection,
    "[limits]": task_schema.LimitsSection,
    "[preference]": task_schema.PreferenceSection,
    "[clearance]": task_schema.ClearanceSection,
    "[iteration]": task_schema.IterationSection,
    "[methods.NAME]": MethodSettings,
    "[study]": task_schema.StudySection,
    "[study.placement]": task_schema.PlacementTable,
    "[study.tool]": task_schema.ToolTable,
    "[study.solver]": task_schema.SolverTable,
    "[study.robot]": task_schema.RobotTable,
}


@pytest.mark.parametrize("title", SECTIONS)
def test_every_key_of_a_task_file_is_listed_with_its_default(title: str) -> None:
    fields = SECTIONS[title].model_fields
    listed = {
        key.strip("`"): default
        for key, _, default, _ in (
            r for r in rows(sections(page("task_files.md"), "###")[title]) if len(r) == 4
        )
    }
    assert sorted(listed) == sorted(fields)
    for key, field in fields.items():
        default = field.get_default(call_default_factory=True)
        if field.is_required():
            assert listed[key] == "required"
        elif default is None:
            assert listed[key] == "–"
        else:
            stated = tomllib.loads(f"x = {listed[key].strip('`')}")["x"]
            assert stated == (list(default) if isinstance(default, tuple) else default)


def test_every_table_of_a_task_file_has_a_section() -> None:
    titles = sections(page("task_files.md"), "###")
    named = {re.split(r"[].]", title.strip("[]"))[0] for title in titles if title.startswith("[")}
    assert named | {"title"} == set(task_schema.TaskFile.model_fields)
    assert [r[0] for r in rows(titles["The file"])] == ["`title`"]


def test_every_method_is_listed_with_what_it_does_by_default() -> None:
    table = rows(sections(page("task_files.md"), "###")["[methods.NAME]"])
    listed = {n: cells[1] for cells in table if len(cells) == 2 for n in cells[0].split(", ")}
    for name, method in METHODS.items():
        settings = method.defaults
        entry = f"iterations {settings.iterations}, secondary `{settings.secondary}`"
        if settings.secondary == "centering":
            entry += f", weight `{settings.weight}`"
        if settings.secondary != "none":
            entry += f", gain {settings.gain}"
        assert listed[f"`{name}`"] == entry
        assert f"`{name}`" in page("command_line.md")


def test_every_metric_is_listed(planar: qt.Comparison) -> None:
    section = sections(page("report.md"), "##")["Metrics"]
    listed = [cells[0].strip("`") for cells in rows(section) if len(cells) == 3]
    content = planar.to_dict()
    assert listed == list(content["methods"]["qp"])
    for key in content:
        assert f"`{key}`" in section


def test_every_command_is_listed_with_its_options(capsys: pytest.CaptureFixture[str]) -> None:
    def help_of(command: str) -> str:
        with pytest.raises(SystemExit) as done:
            main([command, "--help"])
        assert done.value.code == 0
        return capsys.readouterr().out

    listed = sections(page("command_line.md"), "##")
    for command in COMMANDS:
        [body] = [text for title, text in listed.items() if f"qp-twist {command}" in title]
        options = set(re.findall(r"--[a-z][\w-]*", help_of(command))) - {"--help"}
        named = {name for cells in rows(body) for name in re.findall(r"--[a-z][\w-]*", cells[0])}
        assert named == options


NAMED_BY_THE_TASK = {
    "out/TASK", "out/TASK/roadmap.png", "out/TASK_study", "out/TASK_place", "out/NAME_report",
}  # fmt: skip
"""Defaults that a command works out; its help has to say the same words."""


@pytest.mark.parametrize("command", [
    "new", "starts", "compare", "run", "check", "report", "view", "roadmap", "study", "place",
    "tolerance", "bench",
])  # fmt: skip
def test_every_default_of_a_command_is_that_of_its_function(command: str) -> None:
    function = getattr(importlib.import_module(f"qp_twist.cli.{command}"), command)
    parameters = inspect.signature(function).parameters
    told = " ".join((inspect.getdoc(function) or "").split())
    [body] = [t for title, t in sections(page("command_line.md"), "##").items()
              if f"qp-twist {command}" in title]  # fmt: skip
    defaults = {name.rstrip("_"): one.default for name, one in parameters.items()}
    of_toolpath = vars(defaults["toolpath"]) if "toolpath" in defaults else {}
    defaults |= {
        ToolpathOptions.option(key).strip("-").replace("-", "_"): default
        for key, default in of_toolpath.items()
    }
    for option, stated, _ in (r for r in rows(body) if len(r) == 3):
        name = re.findall(r"--([a-z][\w-]*)", option)[0].replace("-", "_")
        default = defaults[name]
        literal = re.fullmatch(r"`([^`]*)`", stated)
        if default is inspect.Parameter.empty:
            assert stated == "required"
        elif isinstance(default, bool):
            assert stated == (f"`--{name}`" if default else "")
        elif name == "solver":
            assert stated.endswith("`compiled`")
            assert check_solver(None) in ("compiled", "daqp")
            assert "machine code" in told
        elif default is None or default in ("auto", ()):
            assert literal is None or literal[1] in NAMED_BY_THE_TASK | {"auto"}, option
            assert default == "auto" or literal is None or literal[1] in told
        else:
            assert literal is not None, option
            assert literal[1] == str(default) or float(literal[1]) == default, option


def shown_commands() -> list[str]:
    """Every command line in a fenced block of a page or of the README."""
    pages = [*sorted(DOCS.glob("*.md")), DOCS.parent / "README.md"]
    blocks = [b for p in pages for b in re.findall(r"```sh\n(.*?)```", p.read_text("utf-8"), re.S)]
    lines = [line.split(" #")[0].strip() for block in blocks for line in block.splitlines()]
    return sorted({c.strip() for line in lines for c in line.split("&&") if c.strip()})


def test_every_command_that_is_shown_can_be_typed() -> None:
    listed = sections(page("command_line.md"), "##")
    tasks = {path.stem for path in shipped_tasks()}
    seen = 0
    for command in shown_commands():
        words = command.removeprefix(".venv/bin/").split()
        if words[0] == "qp-twist":
            [body] = [text for title, text in listed.items() if f"qp-twist {words[1]}" in title]
            known = set(re.findall(r"--[a-z][\w-]*", body))
            assert {word.split("=")[0] for word in words if word.startswith("--")} <= known, command
            given = [w for w in words[2:3] if re.fullmatch(r"[a-z_]+", w)]
            assert set(given) <= tasks, command
            seen += 1
        elif words[0] == "python" and words[1].endswith(".py"):
            assert (DOCS.parent / words[1]).exists(), command
    assert seen > 8


def test_every_status_and_every_failure_has_its_entry() -> None:
    entries = sections(page("step.md"), "###")
    for status in qt.Status:
        for heading in ("*What happened:*", "*What `velocity` holds:*", "*What to do:*"):
            assert heading in entries[status.name]
    for failure in qt.NoSolutionFound.__subclasses__():
        assert f"`{failure.__name__}`\n:" in page("step.md")
    for attribute in [*qt.Step.__dataclass_fields__, "message"]:
        assert f"| `{attribute}` |" in page("step.md")


def test_the_tolerances_are_those_of_the_code() -> None:
    assert (EQUALITY_TOLERANCE, BOUND_TOLERANCE, SCALE_BACKOFF) == (1e-8, 1e-8, 1e-8)
    assert (OPTIMALITY_TOLERANCE, SINGULARITY) == (1e-6, 1e-3)
    text = " ".join(page("step.md").split())
    for sentence in (
        "task rows hold to 10⁻⁸ (1 + max |b|)",
        "rows hold to 10⁻⁸ (1 + max |q̇|)",
        "gradient of the cost to 10⁻⁶ (1 + max |q̇|)",
        "below ε = 10⁻³",
    ):
        assert sentence in text


def test_every_equation_of_the_paper_is_there_under_its_label() -> None:
    text = page("equations.md")
    for label in PAPER_LABELS:
        assert f"\n$$ ({label})\n" in text
        assert f"\n`{label}`\n" in text


def test_the_lines_of_each_formula_are_where_the_table_says() -> None:
    table = sections(page("equations.md"), "##")["From a formula to its lines"]
    named = re.findall(r"`(\w+/\w+\.py)`: ((?:`\w+`(?:, )?)+)", table)
    assert len(named) == 19
    for file, names in named:
        source = (ROOT / "qp_twist" / file).read_text("utf-8")
        for name in re.findall(r"\w+", names):
            assert re.search(rf"(def|class) {name}\b", source), (file, name)
    for label in (*PAPER_LABELS, "step"):
        assert f"{{eq}}`{label}`" in table


def test_every_test_that_a_page_names_exists() -> None:
    tests = (ROOT / "tests" / "control" / "test_equivalences.py").read_text("utf-8")
    named = re.findall(r"`(test_\w+)`", page("equations.md"))
    assert len(named) == 8
    for name in named:
        assert f"def {name}(" in tests


def test_the_architecture_has_the_rooms_and_the_dependencies_that_the_project_has() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    [contract] = project["tool"]["importlinter"]["contracts"]
    drawing = (DOCS / "figures" / "architecture.svg").read_text("utf-8")
    rooms = [room for floor in contract["layers"] for room in re.findall(r"\w+", floor)]
    assert re.findall(r'class="name"[^>]*>(\w+)<', drawing) == rooms
    table = rows(sections(page("architecture.md"), "##")["What each dependency is for"])
    listed = {name for cells in table for name in cells[0].split(", ")}
    names = {re.split(r"[<>=!]", d)[0] for d in project["project"]["dependencies"]}
    assert listed == names
    for extra in project["project"]["optional-dependencies"].values():
        for dependency in extra:
            name = re.split(r"[<>=!\[]", dependency)[0]
            assert name in page("architecture.md") or name == "qp_twist"


@pytest.mark.parametrize(
    ("name", "most"), [("constraint", 2), ("cost_term", 3), ("toolpath_option", 2)]
)
def test_a_demonstration_applies_and_edits_few_files(name: str, most: int) -> None:
    change = DOCS / "demonstrations" / f"{name}.diff"
    command = ["git", "apply", "--check", "--numstat", str(change)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    files = [line.split("\t")[2] for line in done.stdout.splitlines()]
    assert 0 < len(files) <= most
    assert all(file.startswith("qp_twist/") for file in files)


def test_an_option_of_a_toolpath_is_stated_once(tmp_path: Path) -> None:
    """The demonstrated one is then an argument, a key of a task file, and an option of `new`."""
    sources = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "qp_twist", tmp_path / "qp_twist", ignore=sources)
    change = DOCS / "demonstrations" / "toolpath_option.diff"
    subprocess.run(["git", "apply", "--unsafe-paths", change], cwd=tmp_path, check=True)
    (tmp_path / "line.csv").write_text("made by hand, 1, 2, 3, 4\nx_mm,y_mm,z_mm\n0,0,0\n9,0,0\n")
    source = """
from pathlib import Path
from qp_twist.authoring import Request
from qp_twist.authoring.task_text import toolpath_lines
from qp_twist.cli import main
from qp_twist.paths import read_toolpath
from qp_twist.paths.file_path_schema import FilePath

assert len(read_toolpath("line.csv", skip_lines=1).curves[0]) == 2
assert FilePath(kind="file", file="line.csv", skip_lines=1).skip_lines == 1
request = Request(Path("robot.xml"), Path("line.csv"), skip_lines=1)
assert any(line.startswith("skip_lines = 1\\t") for line in toolpath_lines(request))
main(["new", "--help"])
"""
    done = subprocess.run(
        [sys.executable, "-c", source],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert "--skip-lines INT" in done.stdout, done.stderr


# ---------------------------------------------------------------- the site


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built without a warning."""
    for package in ("sphinx", "furo", "myst_parser", "math_core"):
        if importlib.util.find_spec(package) is None:
            pytest.skip(f"{package} is not installed; pip install -e '.[docs]' brings it.")
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [
            *(sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html"),
            *("-d", folder / "doctrees", DOCS, folder / "html"),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return folder / "html"


@pytest.mark.xdist_group("site")
def test_the_site_needs_no_network(site: Path) -> None:
    asked = set()
    for file in [*site.rglob("*.html"), *site.rglob("*.css")]:
        text = file.read_text("utf-8")
        asked |= set(
            re.findall(r"<(?:script|img|link|iframe)[^>]*(?:src|href)=\"(\w*:?//[^\"]+)", text)
        )
        asked |= set(re.findall(r"(?:url\(|@import)[\s\"']*(\w*:?//[^\"')]+)", text))
    assert asked == set()


@pytest.mark.xdist_group("site")
def test_every_formula_is_drawn_by_the_browser_itself(site: Path) -> None:
    count = 0
    for file in site.rglob("*.html"):
        if "_modules" in file.parts:  # sources, as they are written
            continue
        text = file.read_text("utf-8")
        assert "MathJax" not in text
        assert r"\mathbf" not in text
        assert r"\dot" not in text
        count += text.count("<math")
    assert count > 190
    drawn = (site / "equations.html").read_text("utf-8")
    # Bold T, a dagger, a dot above, a fraction, cases, braces below.
    for mark in ("𝐓", "†", "˙", "<mfrac>", "<mtable", "⏟"):
        assert mark in drawn, mark


@pytest.mark.xdist_group("site")
def test_a_reference_to_an_equation_has_the_equations_number(site: Path) -> None:
    text = (site / "equations.html").read_text("utf-8")
    numbers = dict(
        re.findall(
            r'id="equation-([\w-]+)"(?:(?!id="equation).)*?class="eqno">\((\d+)\)', text, re.S
        )
    )
    assert {label.replace("_", "-").lower() for label in PAPER_LABELS} <= {
        label.replace("_", "-").lower() for label in numbers
    }
    assert len(set(numbers.values())) == len(numbers)
    references = [
        reference
        for file in site.rglob("*.html")
        for reference in re.findall(
            r'href="(?:(?:\.\./)?equations\.html)?#equation-([\w-]+)">\((\d+)\)',
            file.read_text("utf-8"),
        )
    ]
    assert len(references) > 10
    for label, number in references:
        assert numbers[label] == number


@pytest.mark.xdist_group("site")
def test_pages_fit_a_phone_and_draw_their_formulas_without_a_network(site: Path) -> None:
    with open_page() as opened:
        tab = opened.page
        tab.context.set_offline(True)
        for name in ("equations", "edge", "index"):
            opened.go(site / f"{name}.html")
            assert tab.locator("math").count() > 0
            heights = "[...document.querySelectorAll('math')].map(m => m.getBoundingClientRect())"
            assert tab.evaluate(f"{heights}.every(box => box.height > 5 && box.width > 3)")
            for width in (360, 390, 768, 1280):
                tab.set_viewport_size({"width": width, "height": 800})
                assert tab.evaluate("document.scrollingElement.scrollWidth") <= width, name
        # A fraction is drawn as one: it is higher than a line.
        opened.go(site / "equations.html")
        assert tab.locator("mfrac").first.bounding_box()["height"] > 20
        assert opened.requests == []


def test_a_formula_that_cannot_be_drawn_is_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    pytest.importorskip("math_core", reason="pip install -e '.[docs]' brings it")
    renderer = runpy.run_path(str(DOCS / "mathml.py"))
    assert renderer["mathml"](r"\frac{a}{b}", block=False).startswith("<math><mfrac>")
    with caplog.at_level("WARNING"):
        assert renderer["mathml"](r"\nocommand{<}", block=False) == "<code>\\nocommand{&lt;}</code>"
    assert "cannot be written as MathML" in caplog.text
    pieces = renderer["pieces"]
    assert pieces(r"a = b, \qquad c = \underbrace{d \quad e}_{f}") == [
        "a = b,", r"c = \underbrace{d \quad e}_{f}",
    ]  # fmt: skip
    assert pieces("a\n\nb") == ["a", "b"]
    assert pieces(r"a &= b \\ c &= d") == [r"\begin{aligned}a &= b \\ c &= d\end{aligned}"]
    cases = r"w = \begin{cases} 1 & \quad x \\ 2 & y \end{cases}"
    assert pieces(cases + r" \quad z") == [cases, "z"]
