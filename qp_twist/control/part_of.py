"""Attributes of an object that one of the values that it keeps has."""

from __future__ import annotations

import operator
from typing import Any

from qp_twist.errors import InvalidInput


def part_of(path: str) -> Any:
    """The attribute ``holder.name`` of an instance, as one of its own.

    The getter is implemented in C, for attributes that are read at every step.
    """
    holder, _, name = path.partition(".")

    def assign(instance: Any, value: Any) -> None:
        try:
            setattr(getattr(instance, holder), name, value)
        except AttributeError:  # of a value that never changes
            kind = type(instance).__name__
            raise InvalidInput(
                f"a {kind.lower()} keeps the {name} it was made with; make another {kind}.",
                key=name,
            ) from None

    return property(operator.attrgetter(path), assign)
