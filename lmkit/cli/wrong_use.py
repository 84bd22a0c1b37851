"""Messages for the parser's errors, with a hint."""

from __future__ import annotations

from typing import Any


def wrong_use(error: Any) -> tuple[str, str, int]:
    """Problem, hint and exit code of an error of the parser."""
    command = getattr(getattr(error, "ctx", None), "command_path", "lmkit")
    return _problem(error), f"see {command} --help", int(getattr(error, "exit_code", 2))


def _problem(error: Any) -> str:
    """The parser's message, with the meaning of a missing option, or the options that replace ``-o``."""
    sentence = str(error.format_message()).rstrip(".")
    if type(error).__name__ == "MissingParameter" and getattr(error.param, "help", None):
        return f"{sentence}: {error.param.help.rstrip('.')}"
    if getattr(error, "option_name", None) in ("-o", "--output"):
        outputs = [p.opts[0] for p in error.ctx.command.params if "to write" in (getattr(p, "help", None) or "")]
        if outputs:
            return f"No such option: {error.option_name}; this command writes files with {', '.join(outputs)}"
    return sentence
