"""Messages for misspelled commands and options."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any, get_args, get_type_hints

import tyro

_POSITIONAL = get_args(tyro.conf.Positional[int])[1]
_ONE_FLAG = get_args(tyro.conf.FlagCreatePairsOff[bool])[1]
_ARGUMENT: Any = type(tyro.conf.arg())
_ALWAYS = ("--help", "--quiet")
_COMPLETION = ("--tyro-print-completion", "--tyro-write-completion")
"""tyro's own: scripts by which a shell completes commands and options."""


def check_names(
    line: Sequence[str], commands: Sequence[str], function: Callable[[str], Callable[..., Any]]
) -> None:
    """Refuse an unknown command or option, and suggest the nearest.

    All other checks of the arguments are tyro's.

    Args:
        line: The words of the command line, without ``--quiet``; at least one.
        commands: The names of the commands.
        function: The function of a command.

    Raises:
        InvalidInput: If the first word is not a command, or a word with ``--`` not an option.
    """
    words = [word.partition("=")[0] for word in line]
    if words[0] in _COMPLETION:
        return
    command, *rest = words
    known = options_of(function(command)) if command in commands else []
    unknown = [w for w in rest if w.startswith("--") and w.replace("_", "-") not in known]
    if command in commands and not unknown:
        return
    from qp_twist.checks import did_you_mean  # with mink: only to refuse
    from qp_twist.errors import InvalidInput

    if command not in commands:
        if command == "--version":
            raise InvalidInput("--version stands alone: qp-twist --version.")
        if command.startswith("-"):
            hint = did_you_mean(command, [*_ALWAYS, "--version"])
            raise InvalidInput(f"there is no option {command} before the command{hint}")
        hint = did_you_mean(command, commands)
        raise InvalidInput(
            f"there is no command {command!r}{hint} Commands: {', '.join(sorted(commands))}."
        )
    hint = did_you_mean(unknown[0], known).replace("'", "")
    raise InvalidInput(
        f"{command}: there is no option {unknown[0]}{hint} Options: {', '.join(known)}; "
        f"qp-twist {command} --help explains them."
    )


def options_of(command: Callable[..., Any]) -> list[str]:
    """The options of a command."""
    return [*_own_options(command), *_ALWAYS]


def _own_options(command: Callable[..., Any]) -> list[str]:
    """The options that tyro derives from the parameters of a function or dataclass."""
    hints = get_type_hints(command, include_extras=True)
    options: list[str] = []
    for name in inspect.signature(command).parameters:
        conf = get_args(hints[name])[1:]
        if _POSITIONAL in conf:
            continue
        argument: Any = next((one for one in conf if isinstance(one, _ARGUMENT)), None)
        if argument is not None and argument.constructor_factory is not None:
            options += _own_options(argument.constructor_factory())
            continue
        option = (argument and argument.name) or name.rstrip("_").replace("_", "-")
        options.append(f"--{option}")
        is_flag = hints[name] is bool or get_args(hints[name])[:1] == (bool,)
        if is_flag and _ONE_FLAG not in conf:
            options.append(f"--no-{option}")
    return options
