"""No retired word is left in the documentation (tests/house/retired_words.txt)."""

from __future__ import annotations

import re
from functools import cache

from doc_pages import NOTEBOOKS, PAGES, ROOT, prose_of

LIST = ROOT / "tests/house/retired_words.txt"


@cache
def retired_words() -> list[tuple[re.Pattern[str], str]]:
    """(expression, what to write instead) of every line."""
    lines = [line for line in LIST.read_text(encoding="utf-8").splitlines() if line and not line.startswith("#")]
    return [(re.compile(word, re.IGNORECASE), instead) for word, instead in (line.split("\t") for line in lines)]


def test_no_retired_word() -> None:
    found = [
        f"{path.relative_to(ROOT)}, line {number}: {match.group()!r}: write {instead}"
        for path in [*PAGES, *NOTEBOOKS]
        for number, line in enumerate(prose_of(path).splitlines(), 1)
        for word, instead in retired_words()
        for match in word.finditer(line)
    ]
    assert not found, "\n".join(found)


def test_the_list_finds_a_retired_word() -> None:
    words = [word for word, _ in retired_words()]
    assert any(word.search("Both eyes see the picture.") for word in words)
    assert not any(word.search("Both cameras see the image.") for word in words)
