"""The latency budget of a live run: above it the profile is ``fast``, then every other image is skipped."""

from __future__ import annotations

from collections import deque

import numpy as np

STEPS = 45  # steps for the 95 % latency
CALM_STEPS = 150  # steps within the budget before the work is increased again
EASY = 0.5  # share of the budget; the work is increased only below it


class LatencyBudget:
    """Keeps the 95 % latency below a bound by reducing the work.

    Attributes:
        level: 0 the requested profile, 1 ``fast``, 2 ``fast`` and every other image.
    """

    def __init__(self, budget_s: float, profile: str) -> None:
        self._budget_s, self._profile = budget_s, profile
        self._latencies: deque[float] = deque(maxlen=STEPS)
        self._steps = 0
        self.level = 0

    @property
    def profile(self) -> str:
        """The detector's current profile."""
        return self._profile if self.level == 0 else "fast"

    @property
    def every(self) -> int:
        """One of this number of images is searched."""
        return 2 if self.level == 2 else 1

    def p95_s(self) -> float:
        """The 95 % latency of the last steps."""
        return float(np.percentile(self._latencies, 95)) if self._latencies else 0.0

    def add(self, latency_s: float) -> str | None:
        """Add the latency of a step; a sentence if the level changes."""
        self._latencies.append(latency_s)
        self._steps += 1
        if len(self._latencies) < STEPS:
            return None
        p95 = self.p95_s()
        if p95 > self._budget_s and self.level < 2:
            self._change(+1)
            what = "profile fast" if self.level == 1 else "every other image"
            return f"95 % latency is {1000 * p95:.0f} ms, over {1000 * self._budget_s:.0f} ms: {what}"
        if p95 < EASY * self._budget_s and self.level > 0 and self._steps > CALM_STEPS:
            self._change(-1)
            which = "every image" if self.every == 1 else "every other image"
            return f"95 % latency is {1000 * p95:.0f} ms: back to profile {self.profile}, {which}"
        return None

    def _change(self, by: int) -> None:
        self.level += by
        self._steps = 0
        self._latencies.clear()
