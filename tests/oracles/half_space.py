"""The constraint that the page *Extending* shows."""

from __future__ import annotations

from oracles.scripts import script

HalfSpace = script("docs", "snippets", "half_space.py").HalfSpace
