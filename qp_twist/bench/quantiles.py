"""What is kept of many times."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import BaseModel, ConfigDict


class Quantiles(BaseModel):
    """The median of times, and between what four fifths of them lie, µs.

    A mean would follow the scheduler's interruptions, and a minimum the luckiest step.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    median: float
    p10: float
    p90: float
    count: int

    @classmethod
    def of(cls, nanoseconds: Sequence[int]) -> Quantiles | None:
        """Of times in ns; ``None`` if there are none."""
        if not nanoseconds:
            return None
        p10, median, p90 = np.percentile(np.asarray(nanoseconds) / 1e3, (10, 50, 90))
        return cls(median=float(median), p10=float(p10), p90=float(p90), count=len(nanoseconds))
