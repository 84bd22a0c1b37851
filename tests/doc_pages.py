"""The pages of the documentation as text: prose, code blocks, commands."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("*.md"), ROOT / "benchmarks/README.md", *(ROOT / "docs").rglob("*.md")])
NOTEBOOKS = sorted((ROOT / "docs/notebooks").glob("*.ipynb"))
FENCE = re.compile(r"^( *)```([^\n]*)\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)


def text_of(path: Path) -> str:
    """A page, or the Markdown cells of a notebook."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".ipynb":
        return text
    return "\n\n".join(
        "".join(cell["source"]) for cell in json.loads(text)["cells"] if cell["cell_type"] == "markdown"
    )


def prose_of(path: Path) -> str:
    """A page without code blocks, code spans and link targets; lines keep their numbers."""
    text = FENCE.sub(lambda m: "\n" * m[0].count("\n"), text_of(path))
    text = re.sub(r"`[^`]*`", lambda m: "\n" * m[0].count("\n"), text)
    return re.sub(r"\]\([^)\s]*\)", "]", text)


def blocks_of(path: Path) -> Iterator[tuple[str, str]]:
    """(language, code) of every fenced block."""
    for _, language, code in FENCE.findall(text_of(path)):
        yield language.strip(), code


def commands_of(path: Path) -> Iterator[tuple[str, bool]]:
    """(command line, whole) of every ``lmkit ...``; those in running text may leave arguments out."""
    for language, code in blocks_of(path):
        if language in ("", "bash", "console"):
            for line in re.sub(r" *\\\n *", " ", code).splitlines():
                for part in re.split(r" && | \| ", line.split("  #")[0].strip()):
                    if found := re.match(r"(?:uv run |\.venv/bin/|\$ )?lmkit (.+)", part):
                        yield found[1].strip(), True
    for span in re.findall(r"`([^`]+)`", FENCE.sub("", text_of(path))):
        if found := re.match(r"(?:uv run )?lmkit ([^`]+)", " ".join(span.split())):
            yield found[1].strip(), False
