"""No retired word is left in code, tests and benchmarks (tests/house/retired_words.txt, allowed_words.txt)."""

from __future__ import annotations

import re
from functools import cache

import pytest
from doc_pages import ROOT
from test_documented_words import retired_words

ALLOWED = ROOT / "tests/house/allowed_words.txt"
INVERTED = re.compile(r'"""(Of|The same|As|By|What|Where|Those)\b')
FOLDERS = ("lmkit", "tests", "benchmarks", "tools")
QUOTED = {"test_code_words.py", "test_documented_words.py"}  # they show what is found
FILES = sorted(p for folder in FOLDERS for p in (ROOT / folder).rglob("*.py") if p.name not in QUOTED)


@cache
def allowed_uses() -> tuple[re.Pattern[str], ...]:
    lines = ALLOWED.read_text(encoding="utf-8").splitlines()
    return tuple(re.compile(line.split("\t")[0], re.IGNORECASE) for line in lines if line and line[0] != "#")


def words_of(source: str) -> str:
    """The source with allowed uses removed and identifiers split into their words."""
    for allowed in allowed_uses():
        source = allowed.sub(" ", source)
    return re.sub(r"(?<=[a-z])(?=[A-Z])|_", " ", source)


def found_in(source: str) -> list[str]:
    """One sentence for each retired word and each inverted docstring."""
    words = words_of(source)
    matches = [(m, instead) for word, instead in retired_words() for m in word.finditer(words)]
    lines = [1 + words[: match.start()].count("\n") for match, _ in matches]
    problems = [
        f"line {line}: {match.group()!r}: write {instead}"
        for line, (match, instead) in zip(lines, matches, strict=True)
    ]
    return problems + [f"docstring starts with {m.group(1)!r}: subject first" for m in INVERTED.finditer(source)]


def test_no_retired_word_in_code() -> None:
    found = [
        f"{path.relative_to(ROOT)}: {problem}"
        for path in FILES
        for problem in found_in(f"{path.stem}\n{path.read_text(encoding='utf-8')}")
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("source", ["left_eye = 1", "class EyePair: ...", "# the picture", '"""Of the robot."""'])
def test_a_retired_word_is_found(source: str) -> None:
    assert found_in(source)


@pytest.mark.parametrize("source", ["identity = np.eye(3)", "# filled by the even-odd rule", '"""Robot radius."""'])
def test_a_legitimate_use_is_allowed(source: str) -> None:
    assert not found_in(source)
