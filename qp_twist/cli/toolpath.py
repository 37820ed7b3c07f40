"""The options of a toolpath on the command line, made from their one statement in ``paths``."""

from __future__ import annotations

import re
from dataclasses import make_dataclass
from typing import Annotated, Any, Literal

import tyro

from qp_twist.errors import InvalidInput
from qp_twist.paths.toolpath_options import ReadingOptions, choices


def options_of(model: type[ReadingOptions]) -> Any:
    """A dataclass of a model's options for tyro; ``auto``, or nothing, is what the file says."""
    fields: list[tuple[str, Any, Any]] = []
    for key, field in model.model_fields.items():
        about = (field.description or "")[:1].upper() + (field.description or "")[1:] + "."
        name = model.option(key).removeprefix("--")
        kind: Any
        default: object
        if values := choices(field.annotation):
            kind, default, metavar = Literal["auto", *values], "auto", None
        elif isinstance(field.default, (bool, int, float)):
            kind, default, metavar = type(field.default), field.default, None
        else:
            kind, default, metavar = str | None, None, "TEXT"
        argument = tyro.conf.arg(name=name, metavar=metavar, help=about)
        fields.append((key, Annotated[kind, argument], default))
    return make_dataclass(model.__name__, fields)


def name_option(error: InvalidInput, model: type[ReadingOptions]) -> None:
    """Call what is refused by its option of the command line, in place of its field."""
    field = re.split(r"[.[]", error.key, maxsplit=1)[0]
    if field in model.model_fields and not error.file:
        error.key = model.option(field) + error.key.removeprefix(field)


def given(options: Any) -> dict[str, object]:
    """The options that were given."""
    return {key: value for key, value in vars(options).items() if value not in (None, "auto")}
