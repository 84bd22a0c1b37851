"""A command that refuses mistakes that the parser accepts: an option given twice, an output with a wrong suffix.

An output with the suffix of another kind is usually a mistake, and may be the input image of the command.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

from typer.core import TyperCommand

from lmkit.cli.plain_values import taken_plainly
from lmkit.errors import InputError

_YAML, _CSV, _HTML, _PDF = (".yaml", ".yml", ".json"), (".csv", ".txt"), (".html", ".htm"), (".pdf",)
# Suffixes of the files that an option writes; with the command's name where the option has several meanings.
OUTPUTS = {
    "--plan": (".png", ".svg"),
    "--csv": _CSV,
    "--tum": (".tum", ".txt", ".csv"),
    "--report": _HTML,
    "--certificate": _PDF,
    "--rerun": (".rrd",),
    "--record": (".mcap",),
    "--save-corners": (".json",),
    "--save-detections": _CSV,
    "calibrate --output": _YAML,
    "survey --output": _YAML,
    "map --output": _YAML,
    "convert --output": (*_YAML, ".xml", ".bag", ".mcap"),
    "report --output": _HTML,
}
# Files that are read and written again as the same kind, with --force.
IN_PLACE = (
    {"--known", "--output"},
    {"--map", "--output"},
    {"--intrinsics", "--output"},
    {"--corners", "--save-corners"},
    {"--detections", "--save-detections"},
)
_IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".svg")
KNOWN = {*_IMAGES, ".mp4", ".avi", ".mov", ".mkv", *(suffix for kinds in OUTPUTS.values() for suffix in kinds)}


_TWICE = {"--rig": "give one file; for camera_info files of ROS, a folder with left.yaml and right.yaml"}
KINDS = {"path": "FILE", "int": "N", "float": "NUMBER"}
FOLDERS = ("Folder", "Recording folder", "Project folder", "With --capture: folder")  # starts of help texts


class CheckedOptions(TyperCommand):
    """A command whose options are given at most once, except flags and repeatable options."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        for option in self.params:
            name_value(option)

    def get_params(self, ctx: Any) -> list[Any]:
        """Options and arguments, including the parser's own."""
        return taken_plainly(super().get_params(ctx))

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Arguments of the usage line: ``FILE`` if required, else ``[FILE]``."""
        return [piece.strip("{").replace("}", "") for piece in super().collect_usage_pieces(ctx)]

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse as typer does.

        Raises:
            InputError: an option is given twice, an output has the suffix of another kind of file, or is a file of
                another kind that the command reads.
        """
        values, _, order = self.make_parser(ctx).parse_args(list(args))
        command = str(ctx.info_name)
        for option, count in Counter(order).items():
            takes_one = getattr(option, "is_flag", None) is False and not getattr(option, "multiple", False)
            if count > 1 and takes_one:
                hint = _TWICE.get(option.opts[0], "give it once")
                raise InputError("given_twice", f"{option.opts[0]} is given twice", hint)
            # Reported before the parser reports a missing option.
            _check_suffix(command, max(option.opts, key=len), values.get(option.name))
        rest = super().parse_args(ctx, args)
        paths: dict[Path, str] = {}
        for option in self.params:
            name, value = max(option.opts, key=len), ctx.params.get(option.name or "")
            if not name.startswith("--"):  # lmkit map and convert may write the file that they read
                continue
            for path in value if isinstance(value, list) else [value]:
                if not isinstance(path, Path):
                    continue
                other = paths.setdefault(path.absolute(), name)
                if other == name or {other, name} in IN_PLACE:
                    continue
                if _is_output(command, name) or _is_output(command, other):
                    raise InputError(
                        "same_file", f"{other} and {name} both name {path}", "give the output another name"
                    )
        return rest


def name_value(option: Any) -> None:
    """Name the value of an option or argument for its help text: ``FILE``, ``N``; not its Python type."""
    if option.metavar is not None or getattr(option, "is_flag", False):
        return
    is_argument, several = option.param_type_name == "argument", option.nargs != 1
    # Newer versions of typer keep the annotation, older ones a type.
    described = getattr(option, "type_descriptor", None)
    annotation = str(getattr(described, "annotation", None) or getattr(option, "type", "")).lower()
    kind = next((word for key, word in KINDS.items() if key in annotation), None)
    of_folder = (option.help or "").startswith(FOLDERS)
    name = str(option.name).rpartition("_")[2].upper()
    option.metavar = name.removesuffix("S") if is_argument and several else name
    if not is_argument and kind is not None:
        option.metavar = "FOLDER" if kind == "FILE" and of_folder else kind
    if is_argument:
        option.display_type_rich = lambda ctx: None  # the name alone


def _is_output(command: str, option: str) -> bool:
    return option in (*OUTPUTS, "--output", "--annotate") or f"{command} {option}" in OUTPUTS


def _check_suffix(command: str, option: str, value: object) -> None:
    allowed = OUTPUTS.get(option, OUTPUTS.get(f"{command} {option}"))
    if not isinstance(value, str) or allowed is None:
        return
    suffix, hint = Path(value).suffix.lower(), f"use a name ending in {' or '.join(allowed)}"
    if option == "--plan" and suffix not in allowed:  # the suffix alone says the kind of image
        raise InputError("bad_suffix", f"cannot write {value}: unknown file type", hint)
    if suffix in KNOWN - set(allowed):
        raise InputError("bad_suffix", f"{option} {value} is named as another kind of file", hint)
