"""viser's player in a page, with recordings for it to play."""

from __future__ import annotations

import base64
import html
import io
import json
from collections.abc import Mapping
from pathlib import Path

_PICTURE_PX = 800
SCRIPT = Path(__file__).with_name("player.js")
"""Plays in each ``.view`` of the page the recording that it names."""


def player() -> str:
    """viser's client, a page that plays ``window.__VISER_EMBED_DATA__``.

    It is the same for all recordings and larger than they are, so a page contains it once.
    """
    import viser

    page = Path(viser.__file__).parent / "client" / "build" / "index.html"
    return page.read_text("utf-8")


def player_data(recordings: Mapping[str, str]) -> str:
    """The player and the recordings, as elements of a page."""
    data = "".join(
        f'<script type="text/plain" class="recording" data-method="{name}">{recording}</script>'
        for name, recording in recordings.items()
    )
    # Escape "</", so that nothing in the JSON script element is parsed as markup.
    client = json.dumps(player()).replace("</", "<\\/")
    return f'{data}<script type="application/json" id="player">{client}</script>'


def still(picture: Path, text: str, *, pixels: int = _PICTURE_PX) -> str:
    """A picture as an ``<img>`` with a small JPEG in it.

    Args:
        picture: PNG file.
        text: What it shows.
        pixels: Largest width and height.
    """
    from PIL import Image

    file = io.BytesIO()
    with Image.open(picture) as opened:
        image = opened.convert("RGB")
        image.thumbnail((pixels, pixels))
        image.save(file, "JPEG", quality=82, optimize=True)
    data = base64.b64encode(file.getvalue()).decode("ascii")
    return f'<img src="data:image/jpeg;base64,{data}" alt="{html.escape(text, quote=True)}">'
