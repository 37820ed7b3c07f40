"""Sphinx configuration: ``sphinx-build -W --keep-going -b html docs docs/_build/html``.

Neither the build nor a reader's browser needs a network: docs/mathml.py writes the formulas as
MathML, which browsers draw by themselves.
"""

from __future__ import annotations

import enum
import inspect
import sys
from pathlib import Path
from typing import Any

import pydantic
from sphinx.util.inspect import stringify_signature

import qp_twist

sys.path.insert(0, str(Path(__file__).parent))  # for mathml

project = "qp_twist"
author = "The qp_twist developers"
project_copyright = f"2026, {author}"
version = release = qp_twist.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",  # from a function to its lines
    "mathml",
]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build", "generated", "snippets"]

myst_enable_extensions = ["amsmath", "attrs_block", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

nitpicky = True
nitpick_ignore_regex = [
    # Their documentation is not fetched (no intersphinx), so their names cannot be links here.
    (r"py:.*", r"(collections\.abc|matplotlib|mink|mujoco|np|npt|numpy|pa|pathlib)\..*"),
    (r"py:.*", r"(Any|Callable|Figure|Literal|Path|Sequence)"),
]
nitpick_ignore = [
    # Aliases: arrays of float64, int64 and bool, poses of many rows, a projector or its matrix,
    # the three frames, a task or a limit, what to do with a task that does not fit, where a sample
    # starts; and a type variable.
    ("py:class", "Array"),
    ("py:class", "Astray"),  # an annotation of a field, by its bare name
    ("py:class", "qp_twist.referee.astray.Astray"),
    ("py:class", "Line"),  # a direction and a point
    ("py:class", "qp_twist.robots.axis_geometry.Line"),
    ("py:class", "Part"),  # of a path: approach, contact …
    ("py:class", "Zone"),  # of a program's points, and the corners that it rounds
    ("py:class", "Corners"),
    ("py:class", "FeedShares"),  # a callable: the tool's share of its programmed speed
    ("py:class", "Posed"),  # what a NamedProblem is made of
    ("py:class", "Counts"),
    ("py:class", "Indices"),
    ("py:class", "Mask"),
    ("py:class", "Targets"),
    ("py:class", "ProjectorLike"),
    ("py:class", "ProjectorFrame"),
    ("py:class", "Item"),
    ("py:class", "LevelItem"),
    ("py:class", "OnInfeasible"),
    ("py:class", "Start"),
    ("py:class", "qp_twist.studies.sample.Start"),
    # What a toolpath's columns and units can be; the toolpaths' page lists them.
    ("py:class", "Format"),
    ("py:class", "LengthUnit"),
    ("py:class", "ArcAxis"),
    ("py:class", "FeedUnit"),
    ("py:class", "TypeAliasForwardRef"),
    ("py:class", "AngleUnit"),
    ("py:class", "Orientation"),
    ("py:class", "Rollover"),
    ("py:class", "Rotary"),
    ("py:class", "Meaning"),
    # What of a path's orientation is that of the start.
    ("py:class", "FromStart"),
    ("py:class", "Column"),
    # Tables of the task file, which have a page of their own.
    ("py:class", "StudySection"),
    # The range of a band, and the axes by which a robot is known: of no use by themselves.
    ("py:class", "qp_twist.kinematics.tolerance_band.Range"),
    ("py:class", "_Axes"),
    ("py:class", "qp_twist.robots.known_robots._Axes"),
    ("py:class", "IterationSection"),
    ("py:class", "MethodSettings"),
    ("py:class", "qp_twist.paths.methods.MethodSettings"),
    # Fields of a dataclass stand in its list of attributes, which makes no targets.
    ("py:attr", "frame"),
]

autoclass_content = "both"
autodoc_inherit_docstrings = False  # mink's and enum's are theirs to show
autodoc_member_order = "bysource"
autodoc_type_aliases = {"Array": "Array"}
python_maximum_signature_line_length = 88
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True

html_theme = "furo"
html_math_renderer = "mathml"
html_title = f"qp_twist {release}"
html_static_path = ["_static"]
html_css_files = ["qp_twist.css"]
html_copy_source = False
html_show_sourcelink = False


def resolve_by_last_name(app: Any, env: Any, node: Any, contnode: Any) -> Any:
    """Link a name to the one entry of the API page that ends in it.

    ``qp_twist.geometry.twist_error`` and ``qp_twist.twist_error`` are one function, and the page
    has it once. Only names of this package are looked for.
    """
    if node.get("refdomain") != "py":
        return None
    module, _, name = node["reftarget"].rpartition(".")
    if module and not module.startswith("qp_twist"):
        return None
    domain = env.get_domain("py")
    found = [entry for entry in domain.objects if entry.rpartition(".")[2] == name]
    if len(found) != 1:
        return None
    return domain.resolve_xref(env, node["refdoc"], app.builder, "obj", found[0], node, contnode)


def signature_as_written(
    app: Any, what: str, name: str, obj: Any, options: Any, signature: str, returns: str
) -> tuple[str, str] | None:
    """Annotations as the source states them: ``npt.ArrayLike`` instead of what it stands for."""
    if not signature or not callable(obj):
        return None
    if isinstance(obj, type) and issubclass(obj, enum.Enum):
        return "", ""
    if isinstance(obj, type) and issubclass(obj, pydantic.BaseModel):
        return "(**fields)", ""  # its attributes say more than pydantic's annotations
    written = inspect.signature(obj)
    if what == "method" and inspect.isfunction(obj):
        written = written.replace(parameters=list(written.parameters.values())[1:])
    result = written.return_annotation
    text = stringify_signature(written, show_return_annotation=False)
    text = text.replace("<factory>", "...")
    return text, result if isinstance(result, str) and what != "class" else ""


def docstring_as_written(
    app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]
) -> None:
    """Two readings that are not meant.

    Napoleon takes "Number of rows: 0 to 6" in a property for a type and a text; reStructuredText
    takes |θ| outside of formulas for a substitution.
    """
    if what == "property":
        lines[:] = (inspect.getdoc(obj) or "").splitlines()
    lines[:] = [
        line if "`" in line or line[:1] == " " else line.replace("|", r"\|") for line in lines
    ]


def setup(app: Any) -> None:
    """Register the three functions."""
    app.connect("missing-reference", resolve_by_last_name)
    app.connect("autodoc-process-signature", signature_as_written)
    app.connect("autodoc-process-docstring", docstring_as_written, priority=600)  # Napoleon: 500
