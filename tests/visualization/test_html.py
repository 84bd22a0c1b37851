"""Tables of reports: numbers and words are aligned apart, wide tables are transposed, and names are escaped."""

from __future__ import annotations

from lmkit.visualization.html import SHORT_ROWS, columns_table, sized, table


def test_numbers_stand_right_and_words_left():
    text = table(("pair", "px", "why"), [("a", "1.0", "<i>")], words=(0, 2))
    assert "<thead><tr><th>pair</th><th class='n'>px</th><th>why</th></tr></thead>" in text
    assert "<td>a</td><td class='n'>1.0</td><td>&lt;i&gt;</td>" in text


def test_only_short_tables_stay_on_one_printed_page():
    rows = [("a", "1")] * SHORT_ROWS
    assert "<div class='table short'>" in table((), rows)
    assert "<thead>" not in table((), rows)
    assert "<div class='table'>" in table((), [*rows, ("b", "2")])


def test_things_with_many_figures_have_one_column_each():
    assert columns_table(("px", "mean", "median"), [("left", "1", "2"), ("right", "3", "4")]) == table(
        ("px", "left", "right"), [("mean", "1", "3"), ("median", "2", "4")]
    )


def test_a_page_shows_the_drawing_for_its_width():
    assert sized("large", "small") == "<div class='wide'>large</div><div class='narrow'>small</div>"
