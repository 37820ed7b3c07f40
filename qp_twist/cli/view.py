"""``qp-twist view``."""

from __future__ import annotations

import sys
import webbrowser
from typing import Annotated

import tyro

from qp_twist.cli.app import MethodName, OptionalFile, Solver, Task, app, say
from qp_twist.cli.path_tasks import load
from qp_twist.paths import DEFAULT_METHOD

Port = Annotated[int | None, tyro.conf.arg(metavar="N")]


@app.command
def view(
    task: Task,
    method: MethodName = DEFAULT_METHOD,
    solver: Solver = None,
    path: OptionalFile = None,
    port: Port = None,
    browser: bool = True,
) -> None:
    """Serve a page on this machine to run a task, drag its target and change its settings.

    Ctrl-C ends it, exit code 0.

    Args:
        task: Name of a shipped task, or path to a .toml file.
        method: Initial method name.
        solver: Initial backend of the QPs; if omitted, machine code.
        path: Toolpath to follow instead of the task's own, e.g. path.csv.
        port: Port of 127.0.0.1; if omitted, the first free one from 8080 on.
        browser: Open the page in a browser, if this runs in a terminal.
    """
    from qp_twist.viewing import PageSettings, Session, free_port

    free = free_port(port)
    path_task = load(task, path)
    settings = PageSettings.of(path_task, method, solver)
    from qp_twist.viewing.page import Page  # its libraries take a second

    session = Session(path_task, settings)
    page = Page(session, free)
    say(f"{path_task.name}: {page.url} (Ctrl-C ends)")
    if browser and sys.stdout.isatty():
        webbrowser.open(page.url)
    try:
        page.run()
    except KeyboardInterrupt:
        say("ended.")
    finally:
        page.close()
