"""Short names of joints that can still be told apart."""

from __future__ import annotations

from collections.abc import Sequence


def short_names(names: Sequence[str], length: int) -> list[str]:
    """Each name in at most ``length`` characters, different for different names.

    Names that fit are as they are. Otherwise words, between ``_``, that all names begin or end with
    are left out; of a name that is still too long the middle is left out (``…``), since its end
    tells a joint from the next one. Where two are then the same, their numbers in the list, from 1,
    stand in front.
    """
    if all(len(name) <= length for name in names):
        return list(names)
    words = [name.split("_") for name in names]
    while len(words) > 1 and all(len(w) > 1 and w[0] == words[0][0] for w in words):
        words = [w[1:] for w in words]
    while len(words) > 1 and all(len(w) > 1 and w[-1] == words[0][-1] for w in words):
        words = [w[:-1] for w in words]
    found = [_cut("_".join(w), length) for w in words]
    return [
        name if found.count(name) == 1 else f"{k} {_cut(name, length - len(f'{k} '))}"
        for k, name in enumerate(found, start=1)
    ]


def _cut(name: str, length: int) -> str:
    if len(name) <= length:
        return name
    end = min(len(name) - 1 - name.rfind("_"), length // 2)
    return f"{name[: length - 1 - end]}…{name[len(name) - end :]}"
