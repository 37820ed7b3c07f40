"""Jobs of a study whose processes die, or do not end.

In a file of their own: each process that is started for them imports it.
"""

import dataclasses
import os
import signal
from pathlib import Path
from typing import Any


@dataclasses.dataclass(frozen=True)
class Dying:
    """A job whose process dies in sample 3 the first time, in sample 11 always."""

    folder: Path

    def __call__(self, index: int) -> list[dict[str, Any]]:
        mark = self.folder / str(index)
        if index == 11 or (index == 3 and not mark.exists()):
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return [{"sample": index, "square": index**2}]

    def failed(self, index: int, message: str) -> list[dict[str, Any]]:
        return [{"sample": index, "square": None, "message": message}]
