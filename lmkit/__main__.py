"""`python -m lmkit` is the command `lmkit`."""

from __future__ import annotations

from lmkit.cli.main import main

# Worker processes import this module under another name.
if __name__ == "__main__":
    main()
