"""Pages: templates filled in, figures and pictures inside them."""

from __future__ import annotations

import base64
import html
import io
from pathlib import Path

from qp_twist.drawing import Picture

_FOLDER = Path(__file__).parent


def fill_template(name: str, script: str = "", **values: object) -> str:
    """A page: the template ``NAME.html.j2`` with all its values, and a script beside the player's.

    Texts are escaped; HTML is what has ``__html__``.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(_FOLDER), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    scripts = [*([script] if script else []), "player.js"]
    return environment.get_template(f"{name}.html.j2").render(
        style=(_FOLDER / "page.css").read_text("utf-8"),
        script="".join((_FOLDER / script).read_text("utf-8") for script in scripts),
        **values,
    )


def figure_html(svg: str, caption: str) -> str:
    """An SVG with its caption, HTML."""
    return f'<figure><div class="drawing">{svg}</div><figcaption>{caption}</figcaption></figure>'


def still_html(picture: Picture, pixels: int = 1100) -> str:
    """A picture as an ``<img>`` with a small JPEG in it, at most so many pixels wide and high."""
    from PIL import Image

    file = io.BytesIO()
    image = Image.open(io.BytesIO(picture.png)).convert("RGB")
    image.thumbnail((pixels, pixels))
    image.save(file, "JPEG", quality=82, optimize=True)
    return image_html(file.getvalue(), "jpeg", picture.text)


def image_html(content: bytes, kind: str, text: str) -> str:
    """An ``<img>`` with the content of a file, ``"png"`` or ``"jpeg"``; its text is read aloud."""
    data = base64.b64encode(content).decode("ascii")
    return f'<img src="data:image/{kind};base64,{data}" alt="{html.escape(text, quote=True)}">'
