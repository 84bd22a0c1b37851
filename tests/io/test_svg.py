"""SVG drawings give the lines that a browser draws; paths agree with svgelements, another reader of SVG."""

from __future__ import annotations

import numpy as np
import pytest

from lmkit.errors import InputError
from lmkit.io import svg_lines, svg_path
from lmkit.io.floor_plan import read_floor
from lmkit.io.svg_lines import read_svg_lines
from lmkit.io.svg_path import path_polylines
from lmkit.io.svg_values import fit_view_box, transform_of

HEAD = (
    '<svg width="297mm" height="210mm" viewBox="0 0 297 210" xmlns="http://www.w3.org/2000/svg" '
    'xmlns:xlink="http://www.w3.org/1999/xlink" xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape">'
)
ROOM = '<path style="fill:none;stroke:#000" d="m 50,50 h 120 v 80 h -120 z"/>'
MM = 96 / 25.4


def drawn(tmp_path, body, head=HEAD):
    """(N,2,2) ends of all lines, as drawn (y down), from the lowest and leftmost."""
    (tmp_path / "plan.svg").write_text(f"{head}{body}</svg>")
    ends = np.array(read_svg_lines(tmp_path / "plan.svg"))
    ends[..., 1] = ends[..., 1].max() - ends[..., 1]
    return ends


def lengths(ends):
    return sorted(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).round(6).tolist())


@pytest.mark.parametrize(
    "hidden",
    [
        '<rect width="100%" height="100%" fill="white"/>',
        '<rect x="-1" y="-1" width="300" height="212" style="fill:#eee"/>',
        '<g inkscape:groupmode="layer" style="display:none"><path d="M 110,50 V 130"/></g>',
        '<g visibility="hidden"><path d="M 110,50 V 130"/></g>',
        '<g opacity="0"><path d="M 110,50 V 130"/></g>',
        '<style>/* old */ .st0, .st1 { display : none }</style><path class="wall st1" d="M 110,50 V 130"/>',
        '<defs><path id="a" d="M 110,50 V 130"/></defs><symbol id="s"><path d="M 0 0 H 500"/></symbol>',
        '<clipPath id="c"><path d="M 0,0 H 999"/></clipPath><text x="3" y="4">Room 1</text>',
        '<rect x="60" y="60" width="30" height="10" fill="#ffffff"/>',
    ],
)
def test_what_cannot_be_seen_is_no_wall(tmp_path, hidden):
    assert lengths(drawn(tmp_path, hidden + ROOM)) == [80, 80, 120, 120]


def test_a_visible_child_of_a_hidden_layer_is_drawn(tmp_path):
    ends = drawn(tmp_path, '<g visibility="hidden"><path d="M0 0h9"/><path visibility="visible" d="M0 0h5"/></g>')
    assert lengths(ends) == [5]


def test_units_are_those_of_a_browser(tmp_path):
    body = '<line x1="50mm" y1="50mm" x2="170mm" y2="50mm"/><line x1="1in" x2="2in"/><line x1="10%" x2="60%"/>'
    assert lengths(drawn(tmp_path, body)) == pytest.approx(sorted([120 * MM, 96, 148.5]), abs=1e-6)


def test_a_door_is_an_arc_of_lines(tmp_path):
    door = (
        '<path d="M 50,50 H 170 V 130 H 50 V 100"/><path d="M 50,100 A 18,18 0 0 1 68,82"/><path d="M68,82 H50 V50"/>'
    )
    ends = drawn(tmp_path, door)
    arc = [line for line in ends if np.linalg.norm(line[0] - line[1]) < 3]
    assert sum(lengths(np.array(arc))) == pytest.approx(18 * np.pi / 2, rel=1e-3)
    (tmp_path / "plan.svg").write_text(f"{HEAD}{door}</svg>")
    floor = read_floor(tmp_path / "plan.svg", 0.05)
    assert floor.free.sum() * floor.cell_m**2 == pytest.approx(6 * 4 - 0.9**2 * np.pi / 4, rel=0.05)


def test_uses_symbols_and_nested_drawings_are_placed(tmp_path):
    body = (
        '<defs><path id="wall" d="M0 0h10"/></defs><use href="#wall" x="5" y="2"/>'
        '<use xlink:href="#wall" transform="rotate(90)"/>'
        '<symbol id="door" viewBox="0 0 2 1"><path d="M0 0h2v1"/></symbol>'
        '<use href="#door" y="20" width="20" height="20"/>'
        '<svg x="30" y="10" width="100" height="50" viewBox="5 0 10 10"><path d="M5 0v10"/></svg>'
        '<svg x="200" width="20" height="50" viewBox="0 0 1 1" preserveAspectRatio="none"><path d="M0 0L1 1"/></svg>'
    )
    expected = [
        [[5, 2], [15, 2]], [[0, 0], [0, 10]],
        [[0, 25], [20, 25]], [[20, 25], [20, 35]],
        [[55, 10], [55, 60]], [[200, 0], [220, 50]],
    ]  # fmt: skip
    np.testing.assert_allclose(drawn(tmp_path, body), expected, atol=1e-9)


def test_circles_are_pillars(tmp_path):
    ends = drawn(tmp_path, '<circle cx="20" cy="20" r="2"/><ellipse cx="50" cy="20" rx="9" ry="3"/>')
    assert sum(lengths(ends[:72])) == pytest.approx(4 * np.pi, rel=1e-3)
    assert np.ptp(ends[72:].reshape(-1, 2), axis=0) == pytest.approx([18, 6])


@pytest.mark.parametrize(
    ("body", "code"),
    [
        ('<image href="plan.png" width="9" height="9"/>', "bad_svg"),
        ('<use href="other.svg#wall"/>', "bad_svg"),
        ('<line x1="2em" x2="4"/>', "bad_svg"),
        ('<path d="M0 0 L 1"/>', "bad_svg"),
        ('<path d="L 1 1"/>', "bad_svg"),
        ('<path transform="warp(3)" d="M0 0h1"/>', "bad_svg"),
        ('<path d="M0 0h1e300"/>', "svg_too_large"),
        ('<path d="M0 0' + "h1v1" * 1500 + '"/>', "svg_too_large"),
        ('<g id="g"><use href="#g"/><use href="#g"/></g>', "svg_too_large"),
        ("<g>" * 150 + "</g>" * 150, "svg_too_large"),
        (
            '<g id="b0"><path d="M0 0h1"/></g>'
            + "".join(f'<g id="b{k + 1}">{f"""<use href="#b{k}"/>""" * 10}</g>' for k in range(8)),
            "svg_too_large",
        ),
    ],
)
def test_what_cannot_be_drawn_is_refused_by_name(tmp_path, monkeypatch, body, code):
    monkeypatch.setattr(svg_lines, "MAX_ELEMENTS", 2000)
    monkeypatch.setattr(svg_path, "MOST_POINTS", 2000)
    with pytest.raises(InputError) as refused:
        drawn(tmp_path, ROOM + body)
    assert refused.value.code == code


def random_path(rng):
    """Commands of every kind, compactly written."""
    parts = [f"M{rng.uniform(-9, 9):.2f} {rng.uniform(-9, 9):.2f}"]
    for _ in range(12):
        # svgelements mirrors the last control point of a cubic for t, and of a quadratic for s, against the standard.
        smooth = "tT" if parts[-1][0] in "qQtT" else "sS"
        letter = rng.choice(list("mMlLhHvVcCqQaAzZ" + smooth))
        count = {"m": 2, "l": 2, "h": 1, "v": 1, "c": 6, "s": 4, "q": 4, "t": 2, "z": 0}.get(letter.lower())
        if count is None:
            rx, ry, turn, x, y = rng.uniform(-9, 9, 5)
            large, sweep = rng.integers(0, 2, 2)
            parts.append(f"{letter}{abs(rx):.3f},{abs(ry):.3f} {turn * 10:.1f} {large}{sweep}{x:.3f},{y:.3f}")
        else:
            parts.append(letter + ",".join(f"{v:.3f}" for v in rng.uniform(-9, 9, count)))
    return "".join(parts)


def test_paths_lie_where_another_reader_puts_them():
    svgelements = pytest.importorskip("svgelements")
    rng = np.random.default_rng(7)
    for _ in range(40):
        data = random_path(rng)
        ours = np.vstack([points for points, _ in path_polylines(data)])
        for segment in svgelements.Path(data):
            if isinstance(segment, svgelements.Move | svgelements.Close):
                continue
            for share in (0.0, 1.0):
                point = np.array([*segment.point(share)], dtype=float)
                assert np.linalg.norm(ours - point, axis=1).min() < 1e-6, data
            # Between the ends, the curve is at most one sagitta of a step away from the line.
            point = np.array([*segment.point(0.37)], dtype=float)
            assert distance_to(ours, point) < 0.2, data


def distance_to(points, point):
    a, b = points[:-1], points[1:]
    along = b - a
    share = np.clip(((point - a) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-12), 0, 1)
    return np.linalg.norm(a + share[:, None] * along - point, axis=1).min()


@pytest.mark.parametrize("ratio", [None, "none", "xMinYMax slice", "xMaxYMin meet"])
def test_view_boxes_and_transforms_are_those_of_another_reader(ratio):
    svgelements = pytest.importorskip("svgelements")
    text = svgelements.Viewbox.viewbox_transform(0, 0, 40, 30, 5, 3, 10, 10, ratio)
    other = svgelements.Matrix(text)
    T = fit_view_box((5, 3, 10, 10), 40, 30, ratio)
    np.testing.assert_allclose(T[:2], [[other.a, other.c, other.e], [other.b, other.d, other.f]], atol=1e-9)
    text = "translate(3) rotate(30 4 5) skewX(20) scale(2,-1) skewY(-5) matrix(1 2 3 4 5 6)"
    other, T = svgelements.Matrix(text), transform_of(text)
    np.testing.assert_allclose(T[:2], [[other.a, other.c, other.e], [other.b, other.d, other.f]], atol=1e-9)
