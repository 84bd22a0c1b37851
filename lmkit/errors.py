"""Errors that a user can mend: what is wrong, where, and how to put it right.

A fault of the user's input is an :class:`InputError` (exit code 2); a run that worked but whose
answer is "no" is a :class:`NegativeAnswer` (exit code 1).  Anything else that escapes is a fault
of lmkit itself (exit code 70).
"""

from __future__ import annotations


class LmkitError(Exception):
    """A known failure.

    Args:
        code: short stable name for scripts, e.g. ``image_truncated``.
        message: what is wrong and where, in one line.
        hint: how to mend it, in one line.
    """

    exit_code = 70

    def __init__(self, code: str, message: str, hint: str) -> None:
        super().__init__(message)
        self.code = code
        self.message = " ".join(message.split())
        self.hint = " ".join(hint.split())

    def __reduce__(self) -> tuple[type[LmkitError], tuple[str, str, str]]:
        """So that an error survives the way back from a worker process."""
        return type(self), (self.code, self.message, self.hint)

    def __str__(self) -> str:
        return f"{self.message} ({self.hint})" if self.hint else self.message

    def as_dict(self) -> dict[str, str]:
        """The error as it stands in ``--json`` output."""
        return {"code": self.code, "message": self.message, "hint": self.hint}


class InputError(LmkitError):
    """Wrong use, a bad file or a bad configuration."""

    exit_code = 2


class NegativeAnswer(LmkitError):
    """The run itself worked, but what was asked for is not there."""

    exit_code = 1
