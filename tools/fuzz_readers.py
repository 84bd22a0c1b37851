"""Change valid files at random and read them; exits at the first fault.

Usage: ``python tools/fuzz_readers.py COUNT [SEED]``.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "tests"))
sys.path.append(str(Path(__file__).parents[1] / "tests" / "io"))

from test_hostile_documents import fuzz

if __name__ == "__main__":
    count, seed = int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0
    with tempfile.TemporaryDirectory() as folder:
        print(fuzz(Path(folder), count, seed))
