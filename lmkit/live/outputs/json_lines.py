"""JSON, one object per line, on standard output."""

from __future__ import annotations

import json
import os
import sys

from lmkit.live.outputs.base import OutputLost
from lmkit.live.state import LiveState


class JsonLines:
    """Writes every step, with and without a pose."""

    def send(self, state: LiveState) -> bool:
        """See `Output`."""
        try:
            sys.stdout.write(json.dumps(state.to_dict(), allow_nan=False) + "\n")
            sys.stdout.flush()
        except BrokenPipeError:
            # Later flushes at exit must not fail again.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise OutputLost("nobody reads standard output") from None
        except OSError as error:
            raise OutputLost(f"standard output: {error.strerror or error}") from None
        return True

    def close(self) -> None:
        """See `Output`."""
