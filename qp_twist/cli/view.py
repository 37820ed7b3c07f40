"""``qp-twist view``."""

from __future__ import annotations

import sys
import webbrowser
from contextlib import closing

from qp_twist.cli import app as cli
from qp_twist.cli.path_tasks import load
from qp_twist.paths import DEFAULT_METHOD


@cli.command
def view(
    task: cli.Task,
    method: cli.MethodName = DEFAULT_METHOD,
    solver: cli.Solver = None,
    path: cli.OptionalFile = None,
    port: cli.OptionalCount = None,
    browser: bool = True,
) -> None:
    """Serve a page on this machine to run a task, drag its target and change its settings.

    Ctrl-C ends it, exit code 0.

    Args:
        method: Initial method name.
        solver: Initial backend of the QPs; if omitted, machine code.
        port: Port of 127.0.0.1; if omitted, the first free one from 8080 on.
        browser: Open the page in a browser, if this runs in a terminal.
    """
    from qp_twist.viewing.session import Session
    from qp_twist.viewing.settings import PageSettings

    path_task = load(task, path)
    settings = PageSettings.of(path_task, method, solver)
    from qp_twist.viewing.page import Page  # its libraries take a second

    with closing(Session(path_task, settings)) as session:
        page = Page(session, port)
        cli.say(f"{path_task.name}: {page.server.url} (Ctrl-C ends)")
        if browser and sys.stdout.isatty():
            webbrowser.open(page.server.url)
        try:
            page.run()
        except KeyboardInterrupt:
            cli.say("ended.")
        finally:
            page.stop()
