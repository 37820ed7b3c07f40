"""A real browser for the tests of pages, and for the pictures of them in the documentation.

``open_page`` yields a page of Chromium and writes down what it asked the network for and what went
wrong in it. Without playwright or a browser the test is skipped with a sentence.
"""

import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

# WebGL in software, as on machines without a screen, and nothing that the browser asks the network
# for by itself.
ARGUMENTS = (
    "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage", "--use-gl=angle",
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
)  # fmt: skip
CHROMIUMS = ("chromium", "chromium-browser", "google-chrome")
DESKTOP = (1280, 900)
LOCAL = ("file:", "data:", "blob:", "about:")


class NoBrowserError(Exception):
    """There is no browser here; the message says what to install."""


@dataclass
class Opened:
    """A page of the browser, and what was noted about it.

    Attributes:
        page: playwright's page.
        requests: Addresses that were asked for and are not part of the page or its file.
        errors: Errors of the console and uncaught exceptions.
    """

    page: Any
    requests: list[str] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)

    def go(self, address: str | Path) -> None:
        """Open a file or an address."""
        self.page.goto(Path(address).absolute().as_uri() if isinstance(address, Path) else address)


@contextmanager
def browser_page(size: tuple[int, int] = DESKTOP) -> Iterator[Opened]:
    """Yield a page of a new browser.

    Raises:
        NoBrowserError: If playwright or a browser is missing.
    """
    try:
        from playwright.sync_api import Error, sync_playwright
    except ImportError:
        raise NoBrowserError(
            "playwright is not installed; pip install playwright brings it."
        ) from None
    found = next((path for name in CHROMIUMS if (path := shutil.which(name))), None)
    with sync_playwright() as playwright:
        try:
            browser = playwright.chromium.launch(executable_path=found, args=list(ARGUMENTS))
        except Error as error:
            said = str(error).splitlines()[0]
            raise NoBrowserError(
                f"no browser starts ({said}); playwright install chromium brings one."
            ) from None
        try:
            opened = Opened(browser.new_page(viewport={"width": size[0], "height": size[1]}))
            opened.page.on("request", lambda request: _note_request(opened, request.url))
            opened.page.on("console", lambda message: _note_message(opened, message))
            opened.page.on("pageerror", lambda error: opened.errors.append(str(error)))
            yield opened
        finally:
            browser.close()


@contextmanager
def open_page(size: tuple[int, int] = DESKTOP) -> Iterator[Opened]:
    """As :func:`browser_page`, but a test without a browser is skipped."""
    with ExitStack() as stack:
        try:
            opened = stack.enter_context(browser_page(size))
        except NoBrowserError as error:
            pytest.skip(str(error))
        yield opened


def _note_request(opened: Opened, url: str) -> None:
    if not url.startswith(LOCAL):
        opened.requests.append(url)


def _note_message(opened: Opened, message: Any) -> None:
    if message.type == "error":
        opened.errors.append(message.text)
