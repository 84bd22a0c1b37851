"""Programs of jobs: one task as JSON on the command line, and errors as one line."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from typing import Any

from lmkit.errors import LmkitError


def run_task(work: Callable[[dict[str, Any]], None]) -> int:
    """Run the task of the command line; the exit code."""
    try:
        work(json.loads(sys.argv[1]))
    except LmkitError as error:
        sys.stderr.write(f"lmkit: {error.message}; {error.hint}\n")
        return error.exit_code
    return 0
