"""Read public toolpaths of CAM systems, machines and robots as shipped, and measure them twice.

    python benchmarks/public_toolpaths.py FOLDER [--out DIR]

``FOLDER/OWNER+NAME`` is a checkout of each repository on GitHub that the list below names. Beside
what ``qp-twist show`` says stand lengths and extents of the cuts from readers that share no code
with the package: they know just the words of these files.
"""

import argparse
import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from qp_twist.errors import InvalidInput
from qp_twist.files import LENGTHS
from qp_twist.paths import read_toolpath
from qp_twist.paths.toolpath_summary import summarize

Array = npt.NDArray[np.float64]
Cuts = list[list[Array]]
"""Points of each cut, in the unit of the file."""
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


def arc(start: Array, end: Array, centre: Array, axis: Array, turns: int = 1) -> Iterator[Array]:
    """Points of an arc or helix, right-handed about an axis; a full circle to where it begins."""
    u, v = start - centre, end - centre
    rise = (v - u) @ axis
    u, v = u - (u @ axis) * axis, v - (v @ axis) * axis
    angle = math.atan2(axis @ np.cross(u, v), u @ v) % (2.0 * math.pi)
    angle = (angle if angle > 1e-7 else 2.0 * math.pi) + 2.0 * math.pi * (turns - 1)
    for share in np.linspace(0.0, 1.0, 1 + math.ceil(angle / 0.005))[1:]:
        cos, sin = math.cos(share * angle), math.sin(share * angle)
        yield start - u + cos * u + sin * np.cross(axis, u) + share * rise * axis


def apt(text: str) -> Cuts:
    """RAPID, GOTO and CIRCLE of NX, whose arcs turn left-handed, or of others."""
    left_handed = "TLDATA" in text
    cuts: Cuts = [[]]
    at, circle, rapid = None, None, False
    hole: dict[str, float] = {}
    text = re.sub(r"\$\$.*", "", text)
    for line in re.sub(r"\$\s*\n", "", text).splitlines():
        word, _, rest = line.partition("/")
        word, numbers = word.strip(), [float(v) for v in re.findall(_NUMBER, rest)]
        if word in ("RAPID", "TOOL PATH", "GOHOME", "FROM"):
            rapid, at = word == "RAPID", at if word == "RAPID" else None
        elif word == "CIRCLE":
            times = re.search(r"TIMES\s*,\s*(\d+)", rest)
            circle = np.array(numbers[:6]), int(times[1]) if times else 1
        elif word == "CYCLE" and not rest.startswith(("INIT", "CLEAR")):
            hole = {key: float(value) for key, value in
                    re.findall(rf"(FEDTO|RAPTO|RTRCTO),\s*({_NUMBER})", rest)}  # fmt: skip
        elif word == "GOTO":
            point = np.array(numbers[:3])
            if hole:
                up = np.array([0.0, 0.0, 1.0])
                at = point + max(hole["RAPTO"], hole.get("RTRCTO", 0.0)) * up
                cuts += [[point + hole["RAPTO"] * up, point - hole["FEDTO"] * up], [at]]
            elif rapid or at is None:
                cuts.append([point])
            elif circle is None:
                cuts[-1].append(point)
            else:
                (centre, axis), turns = np.split(circle[0], 2), circle[1]
                axis = (-axis if left_handed else axis) / np.linalg.norm(axis)
                cuts[-1] += arc(at, point, centre, axis, turns)
            at, circle, rapid = at if hole else point, None, False
    return cuts


def gcode(text: str) -> Cuts:
    """G0 to G3 in any plane, G90 and G91, I, J, K relative to the start, or R."""
    cuts: Cuts = [[]]
    at, mode, relative, plane = dict.fromkeys("XYZ", 0.0), 0, False, "XYZ"
    prints, filament = re.search(r"^G1\b.*\bE-?\d", text, re.MULTILINE) is not None, 0.0
    for line in re.sub(r"\([^)]*\)|;.*", "", text).upper().splitlines():
        words = re.findall(rf"([A-Z])\s*({_NUMBER})", line.lstrip("/"))
        codes = {float(value) for name, value in words if name == "G"}
        mode = next((int(code) for code in codes if code in (0, 1, 2, 3)), mode)
        relative = 91 in codes or (relative and 90 not in codes)
        plane = {17: "XYZ", 18: "ZXY", 19: "YZX"}.get(next(iter(codes & {17, 18, 19}), 0), plane)
        values = {name: float(value) for name, value in words if name in "XYZIJKR"}
        fed = float(dict(words).get("E", filament))
        deposits, filament = not prints or fed > filament, fed
        if not values or codes & {28, 53, 4, 92, 10}:
            continue
        start = np.array([*at.values()])
        for axis in at:
            if axis in values:
                at[axis] = values[axis] + (at[axis] if relative else 0.0)
        end = np.array([*at.values()])
        if mode == 0 or not deposits:
            cuts.append([end])
        elif mode == 1:
            cuts[-1].append(end)
        else:
            normal = np.eye(3)["XYZ".index(plane[2])] * (1.0 if mode == 3 else -1.0)
            centre = start + [values.get(name, 0.0) for name in "IJK"]
            if "R" in values:
                half = 0.5 * (end - start)
                half -= (half @ normal) * normal
                side = math.sqrt(max(0.0, values["R"] ** 2 - half @ half))
                across = np.cross(normal, half) / np.linalg.norm(half)
                centre = start + half + math.copysign(side, values["R"]) * across
            cuts[-1] += arc(start, end, centre, normal)
    return cuts


def klartext(text: str) -> Cuts:
    """L, with FMAX in rapid motion, CC and C."""
    cuts: Cuts = [[]]
    at, pole = dict.fromkeys("XYZ", 0.0), np.zeros(3)
    for line in re.sub(r";.*", "", text).splitlines():
        match = re.match(r"\s*\d*\s*(LN?|CC|C)\s+(.*)", line)
        if match is None or "M91" in line:
            continue
        values = {k: float(v) for k, v in re.findall(rf"\b([XYZ])\s*({_NUMBER})", match[2])}
        if match[1] == "CC":
            pole = np.array([values.get(k, 0.0) for k in "XYZ"])
        if match[1] == "CC" or (match[1] == "L" and not values):
            continue
        start = np.array([*at.values()])
        at |= values
        end = np.array([*at.values()])
        if "FMAX" in line:
            cuts.append([end])
        elif match[1] == "C":
            normal = np.array([0.0, 0.0, 1.0 if "DR+" in line else -1.0])
            cuts[-1] += arc(start, end, pole, normal)
        else:
            cuts[-1].append(end)
    return cuts


def table(columns: tuple[int, int, int], skipped: int = 0) -> Callable[[str], Cuts]:
    """Three columns of a table, one curve."""

    def read(text: str) -> Cuts:
        rows = [re.findall(_NUMBER, line) for line in text.splitlines()[skipped:]]
        return [[np.array([float(row[k]) for k in columns]) for row in rows if len(row) > 2]]

    return read


def targets(pattern: str) -> Callable[[str], Cuts]:
    """Positions behind the words of moves; a joint move begins another cut."""

    def read(text: str) -> Cuts:
        cuts: Cuts = [[]]
        for match in re.finditer(pattern, text, re.MULTILINE):
            point = np.array([float(value) for value in match.groups()[1:]])
            if match[1]:
                cuts.append([point])
            else:
                cuts[-1].append(point)
        return cuts

    return read


def tp(text: str) -> Cuts:
    """L P[n] of a TP program, in the order of the lines, each to its point under /POS."""
    lines, points = text.split("/POS")
    axes = rf"P\[(\d+)\]\s*\{{.*?X = ({_NUMBER}) mm, Y = ({_NUMBER}) mm, Z = ({_NUMBER}) mm"
    at = {n: np.array(xyz, dtype=float) for n, *xyz in re.findall(axes, points, re.DOTALL)}
    return [[at[n] for n in re.findall(r"L P\[(\d+)\]", lines)]]


_CLSF, _APT = "HumMan/CLSFProcessor", "aamorim1913/AptPostProcessor"
_CAMOTICS, _LCNC = "CauldronDevelopmentLLC/CAMotics", "LinuxCNC/linuxcnc"
_5AXIS = "configs/sim/axis/vismach/5axis/table-rotary-tilting/demos/"
FILES: list[tuple[str, str, str, Callable[[str], Cuts]]] = [
    ("Siemens NX", _CLSF, "samples/ust_a2.cls", apt),
    ("Siemens NX", _CLSF, "samples/_3_PAZ_125_N2.cls", apt),
    ("Siemens NX", _CLSF, "samples/_11_KONTUR_125_N2_232.cls", apt),
    ("Siemens NX", _CLSF, "samples/cutcom.clsf", apt),
    ("Siemens NX", _CLSF, "samples/_6_KONTUR_125_N2_46.cls", apt),
    ("CAMWorks", _APT, "parts-2023/Teflon-gasket.apt", apt),
    ("CAMWorks", _APT, "parts-2022/Dem-target1.apt", apt),
    ("CAMWorks", _APT, "parts-2021/basemach.apt", apt),
    ("CAMWorks", _APT, "parts-2022/SupPetriLED.apt", apt),
    ("Heidenhain", _APT, "tests/parts-2021/Teste-Metrologia/11.h", klartext),
    ("Heidenhain", _APT, "tests/parts-2022/shimemcunha/11.h", klartext),
    ("Heidenhain", _APT, "tests/parts-tools/boss/11.h", klartext),
    ("LinuxCNC, 5 axes", _LCNC, _5AXIS + "impeller-7bl-xyzac.ngc", gcode),
    ("LinuxCNC, 5 axes", _LCNC, _5AXIS + "boat-xyzac.ngc", gcode),
    ("LinuxCNC", _LCNC, "nc_files/arcspiral.ngc", gcode),
    ("G-code", _CAMOTICS, "examples/bear/bear.nc", gcode),
    ("G-code", _CAMOTICS, "examples/cameo/cameo.nc", gcode),
    ("G-code", _CAMOTICS, "examples/flower_mold/flower_mold.nc", gcode),
    ("G-code", _CAMOTICS, "examples/scorpion/scorpion.nc", gcode),
    ("G-code", _CAMOTICS, "examples/tiger/tiger.nc", gcode),
    ("G-code", "cncjs/cncjs", "examples/gcode/sample.gcode", gcode),
    ("G-code", "cncjs/cncjs", "examples/gcode/tball/tball.gcode", gcode),
    ("Fusion", "MaestroFusion360/easy_gcode_plot", "cnc programs/PARALLEL.NC", gcode),
    ("G-code, G91", "MaestroFusion360/easy_gcode_plot", "cnc programs/TEST_G91.NC", gcode),
    ("CNCLib", "aiten/CNCLib", "Src/WpfClient/Examples/Examples_BlumeDesLebens.nc", gcode),
    ("Freecad", "MichaHofft/CreoPost",
     "src/CreoPostCmd/Examples/FreeCadToGrbl/platteyz-pass-3-helix.nc", gcode),
    ("Inkscape", "rsharifr/dexarmcontroller", "patterns/HaveBeautifulDay.gcode", gcode),
    ("slicer", "Jayson-Bai/kuka-slicer",
     "packages/offline_path_planner/data/input_gcode/30_20_10_cube/30_20_10_cube.gcode", gcode),
    ("G-code", "winder/Universal-G-Code-Sender", "test_files/shapeoko.txt", gcode),
    ("RoboDK", "RoboDK/RoboDK-API",
     "Python/Examples/Scripts/Example-Import-CSV-XYZWPR.csv", table((0, 1, 2))),
    ("Descartes", "ros-industrial/industrial_training",
     "exercises/5.0/src/myworkcell_core/config/puzzle_bent.csv", table((1, 2, 3))),
    ("IKLink", "uwgraphics/IKLink",
     "input_trajectories/panda_2023-08-25_11-37-55.csv", table((1, 2, 3), 1)),
    ("Stampede", "uwgraphics/stampede", "src/Stampede/FileIO/task_recordings/square",
     table((1, 2, 3))),
    ("RoboDK", "RoboDK/RoboDK-API", "Python/Examples/Scripts/SampleXYZS.csv", table((0, 1, 2))),
    ("KUKA", "luigipacheco/kuka_krl_python", "example.src",
     targets(r"^(?:LIN|(PTP)) \{X (@), Y (@), Z (@)".replace("@", _NUMBER))),
    ("ABB", "arangogang/rapid-toolpath-viewer", "tests/fixtures/multiline.mod",
     targets(r"robtarget \w+ :=()?\s*\[\[(@), (@), (@)\]".replace("@", _NUMBER))),
    ("ABB", "TPHugo/TimovyProjekt", "Stavbar/Stavbar24.9/test_4.prg",
     targets(r"^Move(?:L|(J)) \[\[(@),(@),(@)\]".replace("@", _NUMBER))),
    ("FANUC", "Creearc/welding_project", "layers_splitter/data_result/layer_18.ls", tp),
]  # fmt: skip
"""Dialect, repository, path, and the reader beside."""


def measured(cuts: Cuts) -> tuple[float, Array]:
    """Length and sides of what is cut."""
    kept = [np.array(cut) for cut in cuts if len(cut) > 1] or [np.zeros((2, 3))]
    length = sum(float(np.linalg.norm(np.diff(cut, axis=0), axis=1).sum()) for cut in kept)
    return length, np.ptp(np.concatenate(kept), axis=0)


def row(folder: Path, dialect: str, repository: str, path: str, read: Callable[[str], Cuts]) -> str:
    """A row of the table."""
    file = folder / repository.replace("/", "+") / path
    name = f"{repository} `{path.rpartition('/')[2]}`"
    if not file.is_file():
        return f"| {dialect} | {name} | not there | | | |"
    try:
        toolpath = read_toolpath(file)
    except InvalidInput as error:
        return f"| {dialect} | {name} | refused: {error.sentence.splitlines()[0][:120]} | | | |"
    summary = summarize(toolpath)
    scale = LENGTHS[toolpath.unit]
    length, sides = measured(read(file.read_text("utf-8", "replace")))
    own, here = (summary.high - summary.low) / scale, summary.cut / scale
    return (
        f"| {dialect} | {name} | {toolpath.unit}, {summary.curves} curves, {summary.points:,} "
        f"points | {here:,.6g} · {length:,.6g} | {here / max(length, 1e-9) - 1:.0e} |"
        f" {float(np.abs(own - sides).max()):.1g} |"
    )


def main() -> None:
    """Print the table, and write it if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    lines = [
        "| written by | file | read as shipped | length, here · beside | apart | sides apart |",
        "|---|---|---|--:|--:|--:|",
        *(row(given.folder, *entry) for entry in FILES),
    ]
    print("\n".join(lines))
    if given.out is not None:
        given.out.mkdir(parents=True, exist_ok=True)
        (given.out / "public_toolpaths.md").write_text("\n".join(lines) + "\n", "utf-8")


if __name__ == "__main__":
    main()
