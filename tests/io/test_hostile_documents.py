"""Malicious or damaged documents are refused by name, quickly, and never with another exception."""

from __future__ import annotations

import os
import random
import re
from pathlib import Path

import pytest
from harmed_files import harm_document, harm_number, harm_table, harm_text
from reader_seeds import reader_seeds

from lmkit.errors import InputError
from lmkit.io.documents import load_document, load_json, read_text
from lmkit.io.svg_lines import read_svg_lines
from lmkit.io.template import load_template

HERE = Path("document")


def bomb() -> str:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 12)]
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        (bomb(), "document_too_large"),
        ("a: " + "[" * 500 + "]" * 500, "document_too_large"),
        ("a: " + "[" * 50_000, "bad_yaml"),
        ("a: &a [*a]", "bad_yaml"),
        ("a: !!int abc", "bad_yaml"),
        ("a: !!float [1]", "bad_yaml"),
        ("a: !!bool perhaps", "bad_yaml"),
        ("a: !!timestamp yesterday", "bad_yaml"),
        ("a: " + "9" * 5000, "bad_yaml"),
        ("a: " + "9" * 400, "bad_value"),
        ("a: [1, .nan]", "not_finite"),
        ("a: 1e999", "not_finite"),
        ('a: "\\ud800"', "bad_yaml"),
        ("{a: 1}: 2", "bad_yaml"),
        ("a: 1\n---\na: 2\n", "bad_yaml"),
        ("a: [", "bad_yaml"),
    ],
    ids=lambda value: str(value)[:24],
)
def test_hostile_yaml_is_refused_by_name(text, code):
    with pytest.raises(InputError) as caught:
        load_document(HERE, text)
    assert caught.value.code == code


@pytest.mark.parametrize(
    "text",
    ["[" * 100_000, '{"a": NaN}', '{"a": 1e999}', '{"a": ' + "9" * 5000 + "}", '{"a": "\\ud800"}', "{", '"', "{]"],
    ids=lambda value: value[:16],
)
def test_hostile_json_is_refused(text):
    with pytest.raises(InputError):
        load_json(HERE, text)


def test_dates_and_numbers_to_base_60_are_words():
    text = "{a: 2020-01-01, b: 1:30:00, c: 0777, d: 1e-3, e: -2.5, f: 12, g: 08}"
    assert load_document(HERE, text) == {
        "a": "2020-01-01", "b": "1:30:00", "c": 777, "d": 1e-3, "e": -2.5, "f": 12, "g": 8
    }  # fmt: skip


def test_aliases_within_bounds_are_read():
    assert load_document(HERE, "a: &a [1, 2]\nb: *a\n") == {"a": [1, 2], "b": [1, 2]}


def test_text_as_other_systems_write_it(tmp_path):
    path = tmp_path / "text"
    for data in (b"\xef\xbb\xbfa\r\nb\r\n", "a\nb\n".encode("utf-16"), b"a\rb\r"):
        path.write_bytes(data)
        assert read_text(path, "text") == "a\nb\n"


def test_what_is_no_regular_text_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zeros").write_bytes(b"a\0b")
    (tmp_path / "latin").write_bytes(b"caf\xe9")
    names = [tmp_path / name for name in ("pipe", "zeros", "latin", "missing", "n" * 5000, "a\0b")]
    for path in [*names, Path("/dev/zero"), tmp_path]:
        with pytest.raises(InputError):
            read_text(path, "text")


# Texts of pydantic and Python, which tell a user nothing.
FOREIGN = re.compile(
    r"Input should|should be a valid|invalid literal|could not convert|object is not|has no attribute"
)


def fuzz(folder: Path, count: int, seed: int) -> dict[str, int]:
    """Damage texts ``count`` times and read them; exceptions other than InputError are not caught.

    Returns:
        numbers of texts read and refused.
    """
    rng = random.Random(seed)
    seeds = reader_seeds(folder)
    counts = {"read": 0, "refused": 0}
    for _ in range(count):
        name = rng.choice(sorted(seeds))
        text, read = seeds[name]
        path = folder / name
        path.write_bytes(_harmed(name, text, rng).encode("utf-8", "surrogatepass"))
        try:
            read(path)
            counts["read"] += 1
        except InputError as error:
            assert not FOREIGN.search(str(error)), f"{name}: {error}"
            counts["refused"] += 1
        except Exception as error:
            raise AssertionError(f"{name}: {path.read_bytes()[:3000]!r}") from error
    return counts


def _harmed(name: str, text: str, rng: random.Random) -> str:
    """Pieces of a text changed, or single values of its content."""
    if rng.random() < 0.6:
        return harm_text(text, rng)
    if name.endswith((".csv", ".tum")):
        return harm_table(text, rng)
    is_document = name.endswith((".yaml", ".json", ".fmap"))
    return harm_document(text, rng) if is_document else harm_number(text, rng)


@pytest.mark.filterwarnings("ignore::lmkit.errors.InputWarning")
def test_every_seed_is_read(tmp_path):
    for name, (text, read) in reader_seeds(tmp_path).items():
        (tmp_path / name).write_text(text)
        read(tmp_path / name)


@pytest.mark.filterwarnings("ignore::lmkit.errors.InputWarning")
def test_harmed_files_are_read_or_refused(tmp_path):
    counts = fuzz(tmp_path, 2000, 1)
    assert min(counts.values()) > 100


SVG = '<svg xmlns="http://www.w3.org/2000/svg">{}</svg>'


@pytest.mark.parametrize(
    ("body", "code"),
    [
        ("<g>" * 5000 + "</g>" * 5000, "svg_too_large"),
        ('<path d="M0 0' + "h1v1" * 150_000 + '"/>', "svg_too_large"),
        ('<line x1="1e400" x2="3"/>', "svg_too_large"),
        ('<line x1="1e300" x2="3"/>', "svg_too_large"),
        ('<rect width="100%" height="100%"/>', "no_walls"),
        ('<g style="display:none"><line x2="3"/></g>', "no_walls"),
        ('<g visibility="hidden"><line x2="3"/></g>', "no_walls"),
    ],
    ids=lambda value: str(value)[:24],
)
def test_drawings_that_hold_no_walls_or_too_many_are_refused(tmp_path, body, code):
    path = tmp_path / "floor.svg"
    path.write_text(SVG.format(body))
    with pytest.raises(InputError) as caught:
        read_svg_lines(path)
    assert caught.value.code == code


def test_a_template_of_more_than_a_megabyte_is_refused(tmp_path):

    (tmp_path / "big.toml").write_text('format = "lmkit-template/1"\n' + "[[texts]]\n" * 120_000)
    with pytest.raises(InputError, match="larger than 1 MiB"):
        load_template(str(tmp_path / "big.toml"))
