"""The constraint that the page *Extending* shows."""

from oracles.scripts import script

HalfSpace = script("docs", "snippets", "half_space.py").HalfSpace
