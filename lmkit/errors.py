"""Errors that a user can fix: what is wrong, where, and how to fix it.

Wrong input is an :class:`InputError` (exit code 2); a run that worked with a negative result is a
:class:`NegativeAnswer` (exit code 1).  Any other exception is an internal error (exit code 70).
"""

from __future__ import annotations

import errno
import sys
import warnings

# Hint where a package of an optional extra is missing.
EXTRA = "in the checkout: uv sync --extra {0}, or pip install '.[{0}]'"


# A full disk, a quota, too many open files; and paths that the system refuses.
_LIMITS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EMFILE, errno.ENFILE, errno.EROFS, errno.EIO}
_PATHS = {errno.ENAMETOOLONG, errno.EACCES, errno.EPERM, errno.ELOOP, errno.ENOTDIR, errno.ENXIO}


class LmkitError(Exception):
    """A known failure.

    Args:
        code: short stable name for scripts, e.g. ``image_truncated``.
        message: what is wrong and where, in one line.
        hint: how to fix it, in one line.

    Examples:
        >>> import lmkit
        >>> try:
        ...     lmkit.read_map("rig.yaml")
        ... except lmkit.LmkitError as error:
        ...     print(error.code, error.exit_code)
        wrong_format 2
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
        """The error in the form of ``--json`` output."""
        return {"code": self.code, "message": self.message, "hint": self.hint}


class InputError(LmkitError):
    """Wrong use, a bad file or a bad configuration."""

    exit_code = 2


class InputWarning(UserWarning):
    """Input that is possible, but probably a mistake; the command line prints it in one line on stderr."""


def warn_caller(warning: UserWarning) -> None:
    """Issue a warning at the line outside lmkit that called it, however deep below the problem was found."""
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_globals.get("__name__", "").split(".")[0] == "lmkit":
        level, frame = level + 1, frame.f_back
    warnings.warn(warning, stacklevel=level)


class NegativeAnswer(LmkitError):
    """The run itself worked, but what was asked for is not there."""

    exit_code = 1


def problem_and_remedy(message: str, hint: str) -> str:
    """Both in one line; what asks a question is followed by a new sentence."""
    if message.endswith("?"):
        separator, hint = " ", f"{hint[:1].upper()}{hint[1:]}"
    else:
        separator = "; "
    return " ".join((f"{message}{separator}{hint}" if hint else message).split())


def system_problem(error: OSError) -> tuple[str, str] | None:
    """An error that the system's limits or a path caused, and how to fix it; None for an internal one."""
    problem = f"cannot write or open {error.filename or 'standard output or a file'}: {error.strerror}"
    if error.errno in _LIMITS:
        return problem, "free space, or raise the limit of the system"
    hint = "check the path and its permissions"
    if error.errno in _PATHS and error.filename is not None:
        return problem, hint
    # As pyarrow does, the text itself may name the path.
    return (str(error.strerror), hint) if error.errno in _PATHS and "'" in str(error.strerror) else None
