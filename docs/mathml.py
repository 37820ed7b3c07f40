"""Sphinx extension: formulas as MathML, written when the site is built.

Browsers draw MathML by themselves, so that a page needs neither a script nor the network. A formula
that cannot be converted is a warning, and with ``-W`` ends the build.
"""

from __future__ import annotations

import html
import re
from typing import Any

from docutils import nodes
from math_core import LatexError, LatexToMathML
from sphinx.util import logging
from sphinx.util.math import get_node_equation_number

_log = logging.getLogger(__name__)
_converter = LatexToMathML(fancy_error=False)
_TOKEN = re.compile(r"\\(?:begin|end)\{\w+\*?\}|\\(?:[A-Za-z]+|.)|[\s\S]")
_DEPTH = {"{": 1, "}": -1, r"\left": 1, r"\right": -1}
_SPACES = (r"\quad", r"\qquad")


def mathml(tex: str, *, block: bool, location: Any = None) -> str:
    """A formula as a ``<math>`` element."""
    try:
        drawn = _converter.convert_with_local_state(tex, displaystyle=block)
        return str(drawn).replace("”", '"')  # the quotation marks of code stay straight
    except LatexError as error:
        _log.warning("a formula cannot be written as MathML: %s", error, location=location)
        return f"<code>{html.escape(tex)}</code>"


def pieces(tex: str) -> list[str]:
    r"""Where a displayed formula may break if the page is too narrow: at its outer ``\quad``.

    As in Sphinx's other renderers a blank line separates equations, and ``\\`` and ``&`` break and
    align the lines of one.
    """
    found: list[str] = []
    for part in filter(None, map(str.strip, tex.split("\n\n"))):
        outer, depth = [""], 0
        for token in _TOKEN.findall(part):
            depth += _DEPTH.get(token, token.startswith(r"\begin{") - token.startswith(r"\end{"))
            if depth == 0 and token in _SPACES:
                outer.append("")
            else:
                outer[-1] += token
        inside = re.sub(r"\\begin\{.*\\end\{\w+\}", "", part, flags=re.DOTALL)
        if r"\\" in inside or "&" in inside:
            found.append(rf"\begin{{aligned}}{part}\end{{aligned}}")
        else:
            found += filter(None, map(str.strip, outer))
    return found


def _inline(self: Any, node: nodes.math) -> None:
    self.body.append(mathml(node.astext(), block=False, location=node))
    raise nodes.SkipNode


def _block(self: Any, node: nodes.math_block) -> None:
    self.body.append(self.starttag(node, "div", CLASS="math notranslate nohighlight"))
    drawn = [mathml(piece, block=True, location=node) for piece in pieces(node.astext())]
    self.body.append(f'<div class="equation">{"".join(f"<div>{d}</div>" for d in drawn)}</div>')
    if node["number"]:
        self.body.append(f'<span class="eqno">({get_node_equation_number(self, node)})')
        self.add_permalink_ref(node, "Link to this equation")
        self.body.append("</span>")
    self.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app: Any) -> dict[str, bool]:
    """Register the renderer ``mathml``."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
