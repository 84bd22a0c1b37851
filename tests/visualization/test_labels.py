"""Labels in plans cover neither each other nor the objects that they name."""

from __future__ import annotations

import re
from itertools import combinations

import numpy as np

from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.visualization.labels import LabelPlacer, line_parts_inside
from lmkit.visualization.plan_view import Polyline, draw_plan

TEXT = re.compile(r'<text x="([-\d.]+)" y="([-\d.]+)" font-size="([-\d.]+)"[^>]*>([^<]*)<')


def test_a_word_evades_lines_and_words():
    placer = LabelPlacer()
    placer.keep_line([(0.0, 100.0), (200.0, 100.0)])
    first, clear = placer.place("abc", 15, [(100.0, 100.0), (100.0, 60.0)])
    assert (first, clear) == ((100.0, 60.0), True)
    second, clear = placer.place("abc", 15, [(100.0, 62.0), (100.0, 100.0), (100.0, 140.0)])
    assert (second, clear) == ((100.0, 140.0), True)
    assert placer.place("abc", 15, [(100.0, 100.0)]) == ((100.0, 100.0), False)


def test_lines_are_cut_at_the_rim():
    parts = line_parts_inside([(1, 1), (2, 2), (9, 9), (3, 3), (2, 4)], (0, 0), (5, 5))
    assert parts == [[(1, 1), (2, 2)], [(3, 3), (2, 4)]]


def test_codes_stay_on_their_side_and_clear_of_the_legend():
    """Landmarks at the lower edge of the plan face outward, and landmarks along a wall are dense."""
    landmarks = [
        MappedLandmark(LandmarkId("lm8", k), 0.18, wall_pose([0.1 * k, 0.0, 1.0], np.deg2rad(-90))) for k in range(20)
    ]
    routes = [Polyline(np.zeros((2, 2)), (0, 0, 0), f"a route with a long name, {k}") for k in range(9)]
    drawn = draw_plan(LandmarkMap(landmarks), [], size_m=(3.0, 2.0), kind="svg", polylines=routes).decode()
    words = [(float(x), float(y), float(size), word) for x, y, size, word in TEXT.findall(drawn)]
    codes = [word for word in words if word[3].isdigit()]
    assert len(codes) == len(landmarks)
    wall = 90 + 2.0 * 150
    assert min(y for _, y, _, _ in codes) > wall
    legend = [y for _, y, size, word in words if "route" in word or "landmark" in word]
    assert max(y for _, y, _, _ in codes) < min(legend) - 12
    assert max(legend) < int(re.search(r'height="(\d+)"', drawn)[1]) - 10
    for a, b in combinations(codes, 2):
        wide = 0.55 * a[2] * (len(a[3]) + len(b[3])) / 2
        assert abs(a[0] - b[0]) > wide or abs(a[1] - b[1]) > 0.9 * a[2], (a, b)


def test_sizes_stand_beside_codes_where_they_differ():
    def drawn(*sizes):
        some = [
            MappedLandmark(LandmarkId("lm8", k), size, wall_pose([k, 0.0, 1.0], np.pi / 2))
            for k, size in enumerate(sizes)
        ]
        return {word for *_, word in TEXT.findall(draw_plan(LandmarkMap(some), [], kind="svg").decode())}

    assert {"0", "1"} <= drawn(0.18, 0.18)
    assert {"0 (180 mm)", "1 (120 mm)"} <= drawn(0.18, 0.12)
