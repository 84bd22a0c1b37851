"""Change valid files at random and read them; exits at the first fault.  SIGTERM ends the run with its counts.

Usage: ``python tools/fuzz_readers.py COUNT [SEED]``.
"""

from __future__ import annotations

import signal
import sys
import tempfile
import warnings
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "tests"))
sys.path.append(str(Path(__file__).parents[1] / "tests" / "io"))

from test_hostile_documents import fuzz

BATCH = 1000

if __name__ == "__main__":
    count, seed = int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0
    stopped: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: stopped.append(number))
    warnings.simplefilter("ignore")
    total = {"read": 0, "refused": 0}
    with tempfile.TemporaryDirectory() as folder:
        for batch in range(-(-count // BATCH)):
            if stopped:
                break
            found = fuzz(Path(folder), min(BATCH, count - batch * BATCH), seed * 1_000_000 + batch)
            total = {key: total[key] + n for key, n in found.items()}
    print(total)
