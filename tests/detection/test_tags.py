"""Square markers: AprilTag and ArUco families, in color and gray, mixed with ring landmarks."""

import warnings

import cv2
import numpy as np
import pytest

import lmkit
from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.detection.linear_image import LinearImage
from lmkit.detection.tag_registration import FOUND, SHARP, TagFit, TagRule, read_tag_at
from lmkit.errors import InputError
from lmkit.generation.artwork import landmark_artwork
from lmkit.generation.page import bare_landmark_page
from lmkit.generation.png import page_to_image
from lmkit.model.families import ALL_FAMILIES, families_named
from lmkit.model.square_marker import SQUARE_FAMILIES

CORNERS = np.array([[70.0, 60.0], [131.0, 66.0], [126.0, 128.0], [66.0, 119.0]])


def photograph(
    family: str,
    code: int,
    corners: np.ndarray = CORNERS,
    turns: int = 0,
    light: float = 1.0,
    noise: float = 1.5,
    inside: float = 1.0,
    shade: float = 1.0,
    haze: float = 0.0,
) -> np.ndarray:
    """(200,220,3) a marker, its white ``inside`` times the paper's, before gray, blurred, in code values.

    Light beyond a line across the middle is ``shade`` times that before it; ``haze`` is added to all light.
    """
    kind = ALL_FAMILIES[family]
    face = np.asarray(page_to_image(bare_landmark_page(kind, code, 180.0), 120))[:, :, ::-1]
    face = np.rot90(face, turns)
    margin = round(len(face) * kind.margin_mm / kind.side_mm)
    sheet = cv2.copyMakeBorder(face, *[margin] * 4, cv2.BORDER_CONSTANT, value=(255, 255, 255))
    side = len(face)
    source = np.array([[0, 0], [side, 0], [side, side], [0, side]], np.float32) + margin - 0.5
    H = cv2.getPerspectiveTransform(source, 4 * corners.astype(np.float32) + 1.5)
    linear = (np.asarray(sheet, np.float32) / 255) ** 2.2
    linear[margin:-margin, margin:-margin] *= inside
    large = cv2.warpPerspective(
        linear, H, (880, 800), flags=cv2.INTER_AREA, borderMode=cv2.BORDER_CONSTANT, borderValue=(0.2, 0.2, 0.2)
    )
    y, x = np.mgrid[0:800, 0:880]
    large[x + 0.4 * y > 4 * (corners.mean(axis=0) @ (1.0, 0.4))] *= shade
    small = cv2.resize(cv2.GaussianBlur(large, (0, 0), 3.0), (220, 200), interpolation=cv2.INTER_AREA)
    noisy = 255 * (light * small + haze) ** (1 / 2.2) + np.random.default_rng(1).normal(0, noise, small.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    "family", ["tag16h5", "tag25h9", "tag36h11", "aruco4x4_50", "aruco6x6_250", "aruco_mip_36h12"]
)
def test_reads_code_and_corners(family: str) -> None:
    found = lmkit.detect(photograph(family, 11), family)
    assert [d.id for d in found] == [lmkit.LandmarkId(family, 11)]
    assert np.abs(found[0].corners - CORNERS).max() < 0.15
    assert found[0].covariance is not None
    assert np.sqrt(np.diag(found[0].covariance)).max() < 0.3


def test_errors_that_all_channels_share_count_once() -> None:
    """Noise of equal size in all channels, independent or the same in each, in an image that is not gray."""
    clean, rng = photograph("tag36h11", 11, noise=0.0) * (0.9, 1.0, 0.95), np.random.default_rng(4)
    own, shared = rng.normal(0, 3, clean.shape), rng.normal(0, 3, (*clean.shape[:2], 1))
    stated = []
    for noise in (own, shared):
        (found,) = lmkit.detect(np.clip(np.round(clean + noise), 0, 255).astype(np.uint8), "tag36h11")
        assert found.covariance is not None
        stated.append(np.trace(found.covariance))
    assert stated[1] > 1.5 * stated[0]


@pytest.mark.parametrize("inside", [0.1, 0.3, 0.7])
@pytest.mark.parametrize("family", ["tag16h5", "tag36h11"])
def test_light_around_need_not_be_the_white_of_the_cells(family: str, inside: float) -> None:
    (found,) = lmkit.detect(photograph(family, 11, inside=inside), family)
    assert found.code == 11
    assert np.abs(found.corners - CORNERS).max() < 0.15


@pytest.mark.parametrize("shade", [0.2, 0.4, 0.7])
@pytest.mark.parametrize("family", ["aruco4x4_50", "tag36h11"])
def test_a_shadow_may_end_on_a_marker(family: str, shade: float) -> None:
    (found,) = lmkit.detect(photograph(family, 11, shade=shade), family)
    assert found.code == 11
    assert np.abs(found.corners - CORNERS).max() < 0.15


@pytest.mark.parametrize("family", ["aruco4x4_50", "tag36h11"])
def test_haze_may_leave_little_contrast(family: str) -> None:
    (found,) = lmkit.detect(photograph(family, 11, light=0.2, haze=0.35), family)
    assert found.code == 11
    assert np.abs(found.corners - CORNERS).max() < 0.4


def test_gray_images_do() -> None:
    gray = cv2.cvtColor(photograph("tag36h11", 3), cv2.COLOR_BGR2GRAY)
    found = detect_landmarks(np.repeat(gray[:, :, None], 3, axis=2), DetectOptions(families_named("tag36h11")))
    assert [d.code for d in found] == [3]
    assert np.abs(found[0].corners - CORNERS).max() < 0.15
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert [d.code for d in lmkit.Detector("tag36h11").detect(gray)] == [3]


@pytest.mark.parametrize("family", ["tag36h11", "aruco4x4_50"])
def test_noise_of_dim_rooms_does_not_hide_a_marker(family: str) -> None:
    (found,) = lmkit.detect(photograph(family, 11, light=0.2, noise=50.0), family)
    assert found.id == lmkit.LandmarkId(family, 11)
    assert np.abs(found.corners - CORNERS).max() < 0.8


def test_a_square_whose_border_is_not_dark_all_around_is_no_marker() -> None:
    image, family = photograph("aruco4x4_50", 11), SQUARE_FAMILIES["aruco4x4_50"]
    clear = read_tag_at(image, CORNERS, family)
    for side in range(4):
        start, end = CORNERS[side], CORNERS[(side + 1) % 4]
        inward = CORNERS.mean(axis=0) - (start + end) / 2
        x, y = (0.4 * start + 0.6 * end + 0.17 * inward).round().astype(int).tolist()
        cv2.circle(image, (x, y), 8, (200, 200, 200), -1)
    open_border = read_tag_at(image, CORNERS, family)
    assert clear is not None and open_border is not None
    assert (clear.rejected, open_border.rejected) == (None, "border")
    assert clear.border_error < 0.1 < 0.25 < open_border.border_error


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_first_corner_turns_with_the_marker(turns: int) -> None:
    (found,) = lmkit.detect(photograph("tag36h11", 42, turns=turns), "tag36h11")
    assert np.abs(found.corners - np.roll(CORNERS, turns, axis=0)).max() < 0.2


def test_mixed_with_ring_landmarks() -> None:
    both = np.hstack([photograph("lm8", 137), photograph("tag36h11", 5)])
    assert sorted(str(d.id) for d in lmkit.detect(both, "lm8,tag36h11")) == ["lm8:137", "tag36h11:5"]
    assert [str(d.id) for d in lmkit.detect(both, "lm8")] == ["lm8:137"]


@pytest.mark.parametrize("family", ["tag36h11", "aruco4x4_50"])
def test_white_on_black_is_read_when_asked_for(family: str) -> None:
    # Swapped in linear light, as if printed so.
    light = (photograph(family, 11) / 255.0) ** 2.2
    swapped = np.round(255 * np.clip(0.75 - 0.7 * light, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    assert len(lmkit.detect(swapped, family)) == 0
    detector = lmkit.Detector(family, inverted_tags=True)
    (found,) = detector.detect(swapped)
    assert found.id == lmkit.LandmarkId(family, 11)
    assert np.abs(found.corners - CORNERS).max() < 0.15
    (again,) = detector.detect(swapped, near=[found])
    assert np.abs(again.corners - found.corners).max() < 0.02
    assert [d.id for d in detector.detect(photograph(family, 11))] == [found.id]


@pytest.mark.parametrize("bits", [10, 12, 16])
def test_gray_of_more_bits_is_read(bits: int) -> None:
    gray = cv2.cvtColor(photograph("tag36h11", 3), cv2.COLOR_BGR2GRAY)
    deep = np.round(gray * ((2.0**bits - 1) / 255)).astype(np.uint16)
    (found,) = lmkit.Detector("tag36h11").detect(deep)
    assert found.code == 3
    assert np.abs(found.corners - CORNERS).max() < 0.15


def test_another_family_is_not_read() -> None:
    image = photograph("tag36h11", 5)
    assert len(lmkit.detect(image, "aruco6x6_50")) == 0
    assert len(lmkit.detect(image, "tag36h10")) == 0


def test_only_around_what_is_expected() -> None:
    image = photograph("tag36h11", 5)
    detector = lmkit.Detector("tag36h11")
    first = detector.detect(image)
    again = detector.detect(image, near=first)
    assert [d.id for d in again] == [d.id for d in first]
    assert np.abs(again.corners - first.corners).max() < 0.02
    assert len(detector.detect(image, near=first.corners + 90)) == 0


def test_nested_dictionaries_are_refused() -> None:
    with pytest.raises(InputError, match="share their drawing"):
        lmkit.detect(photograph("aruco4x4_50", 1), "aruco4x4_50,aruco4x4_250")


def test_first_tag_stands_as_the_april_tag_project_prints_it() -> None:
    # Word of id 0 in the AprilTag paper's table, row by row from the top left, 1 = white.
    word = 0xD5D628584
    bits = [word >> (35 - k) & 1 for k in range(36)]
    assert (SQUARE_FAMILIES["tag36h11"].white[0].ravel() == np.array(bits, bool)).all()


def test_opencv_reads_what_is_printed() -> None:
    face = np.asarray(page_to_image(bare_landmark_page(SQUARE_FAMILIES["aruco5x5_100"], 17, 60.0), 150))
    gray = cv2.copyMakeBorder(cv2.cvtColor(face, cv2.COLOR_RGB2GRAY), *[80] * 4, cv2.BORDER_CONSTANT, value=255)
    reader = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100))
    corners, codes, _ = reader.detectMarkers(gray)
    assert codes.ravel().tolist() == [17]
    first = corners[0][0][0]
    assert np.abs(first - 80).max() < 2


@pytest.mark.parametrize("name", list(SQUARE_FAMILIES))
def test_codes_differ_by_the_stated_distance(name: str) -> None:
    family = SQUARE_FAMILIES[name]
    assert family.white.shape == (family.code_count, family.bits, family.bits)
    some = np.random.default_rng(0).choice(family.code_count, min(family.code_count, 60), replace=False)
    signs = [2.0 * np.rot90(family.white, k, axes=(1, 2)).reshape(family.code_count, -1) - 1 for k in range(4)]
    for quarter, turned in enumerate(signs):
        apart = (family.bits**2 - signs[0][some] @ turned.T) / 2
        if quarter == 0:
            apart[np.arange(len(some)), some] = family.bits**2
        assert apart.min() >= family.distance


def test_codes_outside_are_refused() -> None:
    with pytest.raises(InputError, match="code 587 is outside 0 to 586"):
        landmark_artwork(SQUARE_FAMILIES["tag36h11"], 587)


def test_the_stated_chance_is_that_of_random_insides() -> None:
    family = SQUARE_FAMILIES["aruco4x4_1000"]
    insides = np.random.default_rng(0).random((20_000, 16)) < 0.5
    codes = np.concatenate([np.rot90(family.white, k, axes=(1, 2)) for k in range(4)]).reshape(-1, 16)
    is_code = np.isin(insides @ (1 << np.arange(16)), codes @ (1 << np.arange(16)))
    assert is_code.mean() == pytest.approx(family.chance(0), abs=0.006)
    assert family.chance(0) < family.chance(1) <= 1


def test_families_that_resemble_more_must_be_clearer() -> None:
    rules = {name: TagRule.of(SQUARE_FAMILIES[name]) for name in SQUARE_FAMILIES}
    assert all(rule.false_rate < 1e-3 for rule in rules.values())
    many, few, most = (rules[name].clearness for name in ("aruco4x4_250", "aruco4x4_50", "tag36h11"))
    assert many.squares < few.squares < most.squares


@pytest.mark.parametrize("side", [131, 180, 232, 315, 430, 655, 930])
def test_pixels_of_a_large_marker_lie_in_every_cell(side: int) -> None:
    """Rows are sampled at regular steps, and some steps would leave out whole cells."""
    width = 2 * (side // 2) + 260
    image = LinearImage.of(np.full((width, width, 3), 128, np.uint8))
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    for x, y in ((0.0, 0.0), (13.3, 60.2), (-91.0, 7.7)):
        corners = width / 2 + np.array([x, y]) + square * side / 2
        fit = TagFit(image, SQUARE_FAMILIES["tag36h11"], corners, 1.0, gray=True)
        assert fit.sample(400, near_edges=False)
        cells = np.floor((fit.samples.at.T + fit.view.origin - corners[0]) / (side / 8)).astype(int)
        assert len({tuple(cell) for cell in cells if ((cell >= 0) & (cell < 8)).all()}) == 64


def test_a_fit_moves_though_hardly_anything_is_known_of_the_blur_across_the_edges() -> None:
    """Edges along the axes do not determine the covariance of the blur along x and y."""
    side, finer = 400, 2
    rng = np.random.default_rng(3)
    marker = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11), 5, 8)
    page = np.kron(np.pad(marker, 2, constant_values=255), np.ones((20, 20), np.uint8))
    drawn = np.array([[39.5, 39.5], [199.5, 39.5], [199.5, 199.5], [39.5, 199.5]], np.float32)
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * side / 2
    for _ in range(6):
        true = square * (1 + rng.uniform(-0.01, 0.01, (4, 1))) + 320 + rng.uniform(-3, 3, 2)
        H = cv2.getPerspectiveTransform(drawn, ((true + 0.5) * finer - 0.5).astype(np.float32))
        large = cv2.warpPerspective(page, H, (640 * finer, 640 * finer), borderValue=255).astype(np.float32) / 255
        light = 0.05 + 0.75 * cv2.GaussianBlur(
            cv2.resize(large, (640, 640), interpolation=cv2.INTER_AREA), (0, 0), 0.4
        )
        image = np.repeat((255 * light ** (1 / 2.2)).astype(np.uint8)[:, :, None], 3, axis=2)
        fit = TagFit(
            LinearImage.of(image), SQUARE_FAMILIES["tag36h11"], true + rng.uniform(-1.5, 1.5, (4, 2)), 1.44, True
        )
        assert fit.sample(400, near_edges=True) and fit.decode(FOUND)
        fit.draw_cells()
        fit.register(SHARP)
        assert np.abs(fit.corners - true).max() < 0.3
