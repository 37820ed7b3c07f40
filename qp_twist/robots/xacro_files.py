"""Expand xacro files, templates of a URDF, with the package ``xacro`` and without ROS."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stderr
from pathlib import Path
from typing import Any

from qp_twist.checks import clause
from qp_twist.errors import InvalidInput
from qp_twist.files import is_folder, read_bytes
from qp_twist.robots.ros_packages import how_to_state, package_folders
from qp_twist.robots.wording import reason_of

_ARGUMENT = re.compile(r"<xacro:arg\s[^>]*?name\s*=\s*[\"']([^\"']+)[\"']|\$\(arg\s+([^)\s]+)\s*\)")


def is_xacro(text: str, file: Path) -> bool:
    """Whether the text of a robot's file has to be expanded: by its suffix, or by what is in it."""
    inside = re.search(r"<xacro:\w|=\s*[\"'][^\"'<]*\$[{(]", text)
    return file.suffix.lower() == ".xacro" or inside is not None


def expanded(
    file: Path, packages: Mapping[str, Path], arguments: Mapping[str, str]
) -> tuple[str, list[str]]:
    """The URDF of a xacro file, and xacro's warnings.

    ``$(find NAME)`` is a folder of ``packages``, or one found around the file. Expressions in the
    file are computed by xacro, as Python: expand files of sources that you trust. ``arguments``
    has the values of its ``<xacro:arg>``.

    Raises:
        InvalidInput: If a package or an included file is not found, an argument is missing or not
            one of the file's, or xacro refuses the file.
    """
    import xacro  # only here: most robots are no xacro files
    from xacro import substitution_args

    def find(name: str) -> str:
        folder = next((f for f in package_folders(name, file, packages) if is_folder(f)), None)
        if folder is None:
            raise InvalidInput(
                f"{file}: the ROS package {name!r} is not found around the file. "
                f"{how_to_state(name)}"
            )
        return str(folder.resolve())  # xacro takes other paths from the file that includes

    warnings = io.StringIO()
    with (
        redirect_stderr(warnings),
        _replaced(substitution_args, "_eval_find", find),
        _replaced(substitution_args._eval_dict, "find", find),
    ):
        xacro.all_includes.clear()  # it keeps those of the files before
        try:
            document = xacro.process_file(str(file), mappings=dict(arguments))
        except RecursionError as error:
            raise InvalidInput(f"{file}: it includes itself, or its macros have no end.") from error
        except Exception as error:  # whatever the expressions of the file raise
            causes = list(_causes(error))
            for cause in causes:
                if isinstance(cause, InvalidInput):
                    raise cause from None
                if isinstance(cause, substitution_args.ArgException):
                    raise InvalidInput(_no_value(file, str(cause))) from error
            reason = clause(reason_of(error))
            raise InvalidInput(f"{file}: xacro cannot expand it: {reason}.") from error
    _refuse_unknown(file, [file, *map(Path, xacro.all_includes)], arguments)
    said = [f"xacro: {line.strip()}" for line in warnings.getvalue().splitlines() if line.strip()]
    return str(document.toxml()), said


def _causes(error: BaseException) -> Iterator[BaseException]:
    """An error, and those that it was raised for."""
    at: BaseException | None = error
    while at is not None:
        yield at
        at = getattr(at, "exc", None) or at.__cause__ or at.__context__


def _no_value(file: Path, name: str) -> str:
    return (
        f"{file}: its argument {name!r} has no value; give one: load_robot(..., "
        f"arguments={{{name!r}: value}}), qp-twist new --arg {name}:=value, or in a task "
        f'file [robot.arguments] {name} = "value".'
    )


@contextmanager
def _replaced(of: Any, name: str, function: Any) -> Iterator[None]:
    """Have xacro use another function, to find packages without ROS."""
    names = of if isinstance(of, dict) else vars(of)
    before = names.get(name)
    names[name] = function
    try:
        yield
    finally:
        if before is None:
            del names[name]
        else:
            names[name] = before


def _refuse_unknown(file: Path, files: list[Path], arguments: Mapping[str, str]) -> None:
    known: dict[str, None] = {}
    for each in files:
        text = read_bytes(each).decode("utf-8", "replace")
        known.update(dict.fromkeys(one or two for one, two in _ARGUMENT.findall(text)))
    unknown = [name for name in arguments if name not in known]
    if unknown:
        raise InvalidInput(
            f"{file}: it has no argument {unknown[0]!r}; it has "
            f"{', '.join(map(repr, known)) or 'none'}."
        )
