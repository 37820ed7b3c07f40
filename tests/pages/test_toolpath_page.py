"""The page of a toolpath: it says what was understood, assumed and passed over."""

import re
from pathlib import Path

import numpy as np
from PIL import Image

from qp_twist.pages.toolpath_page import save_toolpath_figure, show_toolpath
from qp_twist.paths import Toolpath, read_toolpath, shipped_folder
from qp_twist.paths.toolpath import Curve

FEEDS = "UNITS/MM\n" + "".join(
    f"FEDRAT/{600 + 100 * k},MMPM\nGOTO/{10 * k},0,{k * k},0,0,1\n" for k in range(5)
)


def test_the_page_states_units_feeds_lengths_and_notes(tmp_path: Path) -> None:
    file = tmp_path / "ramp.apt"
    file.write_text(FEEDS + "COOLNT/ON\n")
    page = show_toolpath(read_toolpath(file), tmp_path / "out" / "ramp.html").read_text("utf-8")
    for words in ("ramp.apt", "1 curve, 5 points, tool axes", "mm, as the file states",
                  "700 to 1000 mm/min", "COOLNT", "Steps"):  # fmt: skip
        assert words in page, words
    own = page.partition('id="player"')[0]  # what follows is viser's client
    assert not re.search(r"<(?:script|img|link|iframe)[^>]*(?:src|href)=.(?!data:)", own)


def test_a_picture_of_any_toolpath_can_be_drawn(tmp_path: Path) -> None:
    one_point = Curve("any", np.zeros((1, 3)), None, None, np.array([3]))
    for number, toolpath in enumerate(
        (
            read_toolpath(shipped_folder("tasks") / "dome_seams.csv"),
            Toolpath(Path("point.csv"), "none", (one_point,)),
        )
    ):
        picture = save_toolpath_figure(toolpath, tmp_path / f"{number}.png")
        with Image.open(picture) as image:
            assert image.size == (1280, 800)
        assert show_toolpath(toolpath, tmp_path / f"{number}.html").is_file()


def test_names_in_a_file_are_no_markup(tmp_path: Path) -> None:
    file = tmp_path / "a<b>&c.csv"
    file.write_text("x [mm],y [mm],z [mm],<script>alert(1)</script>\n0,0,0,1\n1,0,0,1\n2,0,0,1\n")
    page = show_toolpath(read_toolpath(file), tmp_path / "page.html").read_text("utf-8")
    assert "<script>alert" not in page and "a&lt;b&gt;&amp;c.csv" in page
