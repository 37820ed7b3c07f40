"""Base class of all tables of a task file, and what is wrong with one in words."""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Mapping
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from qp_twist.errors import InvalidInput

Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Vector = tuple[Number, Number, Number]
_WORDING = {
    r"Input should be (greater|less) than": r"expected a number \1 than",
    r"Input should be a valid tuple": "expected an array",
    r"Input should be .*(?:dictionary|instance of).*": "expected a table",
    r"Input should be ": "expected ",
    r"\w+ should have (.+?)(?: after validation, not \d+)?$": r"expected \1",
}
"""Messages of pydantic in the words of this package; the first pattern that fits counts."""


class Section(BaseModel):
    """A table of the file: unknown keys are refused, values are not converted."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, arbitrary_types_allowed=True, defer_build=True
    )


_Section = TypeVar("_Section", bound=Section)


def validated(section: type[_Section], values: Mapping[str, object]) -> _Section:
    """A table with the values of some keys.

    Raises:
        InvalidInput: The first problem, with its key.
    """
    try:
        return section.model_validate(values)
    except ValidationError as error:
        raise problems(error)[0] from None


def problems(error: ValidationError) -> list[InvalidInput]:
    """Each problem of a table that was refused, with its dotted key, as in the file."""
    items = error.errors()
    places = [_keys(item) for item in items]
    found = []
    for item, keys in zip(items, places, strict=True):
        # pydantic also reports a list as too short if an entry is refused: report it once.
        if item["type"] == "too_short" and any(
            k != keys and k[: len(keys)] == keys for k in places
        ):
            continue
        key = "".join(f"[{k}]" if isinstance(k, int) else f".{k}" for k in keys).lstrip(".")
        found.append(InvalidInput(_sentence(item, keys), key=key))
    return found


def _keys(item: Any) -> list[str | int]:
    """The keys of a problem, as in the file."""
    keys = list(item["loc"])
    if not keys:
        return ["file"]
    if keys[0] == "path" and len(keys) > 1:
        del keys[1]  # pydantic puts the kind of path there, which is no key of the file
    if keys[0] == "bands" and len(keys) > 2:
        del keys[2]  # and the kind of band
    if item["type"].startswith("union_tag"):
        keys.append("kind")
    if keys[-1] == "[key]":
        del keys[-1]
    return keys


def _sentence(item: Any, keys: list[str | int]) -> str:
    kind = item["type"]
    if kind == "extra_forbidden":
        close = difflib.get_close_matches(str(keys[-1]), _known_keys(Section), n=1)
        # A known key in the wrong table is no misspelling.
        hint = f"; did you mean {close[0]!r}?" if close and close[0] != keys[-1] else " here."
        return f"unknown key{hint}"
    if kind in ("missing", "union_tag_not_found"):
        return "missing; add this key."
    if kind == "union_tag_invalid":
        return f"expected one of {item['ctx']['expected_tags']}; got {item['ctx']['tag']!r}."
    if kind == "value_error":
        return f"{str(item['ctx']['error']).rstrip('.')}."
    text, given = item["msg"].rstrip("."), json.dumps(item["input"], default=str)
    fits = next((pattern for pattern in _WORDING if re.match(pattern, text)), r"$")
    text = re.sub(fits, _WORDING.get(fits, ""), text)
    return f"{text}, got {given if len(given) < 60 else given[:57] + '…'}."


def _known_keys(section: type[Section]) -> set[str]:
    """Every key that the schema knows, in any table."""
    keys = set(section.model_fields)
    for table in section.__subclasses__():
        keys |= _known_keys(table)
    return keys
