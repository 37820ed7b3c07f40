"""The template of a page, filled in."""

from __future__ import annotations

from pathlib import Path


def filled(template: Path, **values: object) -> str:
    """The text of a Jinja template with these values, all of which it has to be given.

    Texts are escaped; HTML is what has ``__html__``.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(template.parent), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    return environment.get_template(template.name).render(**values)
