"""Small tables for results in notebooks."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence

_CELL = "padding:2px 10px;border-bottom:1px solid #ccc"


def html_table(
    caption: str, rows: Iterable[Sequence[object]], heads: Sequence[str] | None = None
) -> str:
    """A self-contained table; all text is escaped.

    Args:
        caption: Text above it.
        rows: Cells; the first of each row is its head. Numbers are right-aligned.
        heads: Heads of the columns, if any.
    """
    top = "".join(
        f'<th scope="col" style="{_CELL}">{html.escape(head)}</th>' for head in heads or ()
    )
    body = "".join(f"<tr>{_head(row[0])}{''.join(map(_cell, row[1:]))}</tr>" for row in rows)
    return (
        '<table style="border-collapse:collapse">'
        f'<caption style="text-align:left;padding:2px 10px"><b>{html.escape(caption)}</b></caption>'
        f"{f'<thead><tr>{top}</tr></thead>' if heads else ''}<tbody>{body}</tbody></table>"
    )


def _head(value: object) -> str:
    return f'<th scope="row" style="text-align:left;{_CELL}">{html.escape(str(value))}</th>'


def _cell(value: object) -> str:
    number = isinstance(value, (int, float))
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    return (
        f'<td style="text-align:{"right" if number else "left"};{_CELL}">{html.escape(text)}</td>'
    )
