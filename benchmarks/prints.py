"""Planted defects: does `lmkit verify` name each by the right line, and report nothing for good prints?

    uv run --extra benchmark python benchmarks/prints.py [--n 10] [--seed 90000] [--family tag36h11]

Simulated: A4 sheets drawn by pypdfium2, in the inks of four kinds of printer, scanned at 150 dpi or
photographed from 0.7 to 0.85 m (f = 1800 px, 1600 x 1200) under lights of 2700 to 6500 K, a gradient, noise,
Bayer, sharpening, JPEG.  The limits in `verification/grade.py` were set on seeds below 1000; report others.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
import pypdfium2

from lmkit.generation.pdf import pages_to_pdf
from lmkit.generation.sheet import compose_landmark_page, usual_size_mm
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.io.template import load_template
from lmkit.model.families import MarkerFamily, family_named
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.palette import linear_to_srgb, srgb_to_linear
from lmkit.simulation.inks import INKJET, LASER, OFFSET, as_printed
from lmkit.simulation.photograph import Development, Gloss, ImagingChain, Lens, Light, Sensor, expose
from lmkit.simulation.render import render
from lmkit.simulation.scene import Panel, Scene
from lmkit.verification.prints import PrintedLandmark, Stated, grade_sheet

DPI = 150.0
PX_PER_MM = DPI / 25.4
PAPER_MM = (210.0, 297.0)
SHEET = load_template("a4")
CENTRE_MM = SHEET.centre_mm
FOCAL_PX, PHOTO_SIZE = 1800.0, (1600, 1200)
PRINTERS = (OFFSET, INKJET, LASER)


@dataclass(frozen=True)
class Sheet:
    """A print before it is looked at: reflectances (linear RGB), the code that its label says, and the side."""

    texture: np.ndarray
    code: int
    size_mm: float


@dataclass(frozen=True)
class Viewing:
    """How it is looked at."""

    blur_px: float = 0.6
    gloss: float = 0.0


Defect = Callable[[Sheet, Viewing, np.random.Generator], tuple[Sheet, Viewing]]


def inked(texture: np.ndarray) -> np.ndarray:
    """(h,w) 0 on paper, 1 on solid ink, of a file's colors."""
    return 1 - np.clip(texture.min(axis=2), 0, 1)


def faded(sheet: Sheet, share: float, red: bool, blue: bool) -> np.ndarray:
    """Less ink on red or on blue."""
    t = sheet.texture
    is_red = np.clip((t[:, :, 0] - t[:, :, 2]) * 2, 0, 1)
    amount = share * inked(t) * (red * is_red + blue * (1 - is_red))
    return t + amount[:, :, None] * (0.85 - t)


def shrunk(texture: np.ndarray, sx: float, sy: float) -> np.ndarray:
    """The drawing smaller on the same paper."""
    height, width = texture.shape[:2]
    A = np.array([[sx, 0, (1 - sx) * width / 2], [0, sy, (1 - sy) * height / 2]])
    return cv2.warpAffine(texture, A, (width, height), flags=cv2.INTER_AREA, borderValue=(1.0, 1.0, 1.0))


def _scaled(sheet, look, rng):
    return replace(sheet, texture=shrunk(sheet.texture, 0.97, 0.97)), look


def _unequal(sheet, look, rng):
    return replace(sheet, texture=shrunk(sheet.texture, 1.0, 0.98)), look


def _faded_blue(sheet, look, rng):
    return replace(sheet, texture=faded(sheet, 0.5, False, True)), look


def _low_ink(sheet, look, rng):
    return replace(sheet, texture=faded(sheet, 0.55, True, True)), look


def _magenta(sheet, look, rng):
    """Too much magenta, hardly any cyan: the blue turns purple."""
    cast = np.array([0.30, -0.05, 0.0])
    amount = np.clip(sheet.texture[:, :, 2:] - sheet.texture[:, :, :1], 0, 1) * 3
    return replace(sheet, texture=np.clip(sheet.texture + np.clip(amount, 0, 1) * cast, 0.01, 1)), look


def _streaks(sheet, look, rng):
    rows = np.arange(sheet.texture.shape[0])
    bare = ((rows / PX_PER_MM + rng.uniform(0, 14)) % 14 < 1.6)[:, None, None]
    lighter = sheet.texture + 0.5 * inked(sheet.texture)[:, :, None] * (0.85 - sheet.texture)
    return replace(sheet, texture=np.where(bare, lighter, sheet.texture)), look


def _cut_margin(sheet, look, rng):
    """Cut 2 mm beside the border; what is behind is dark."""
    texture = sheet.texture.copy()
    edge = round((CENTRE_MM[1] - sheet.size_mm / 2 - 2) * PX_PER_MM)
    texture[:edge] = 0.08
    return replace(sheet, texture=texture), look


def _glare(sheet, look, rng):
    return sheet, replace(look, gloss=0.9)


def _blurred(sheet, look, rng):
    blur = 0.02 * 180 * PX_PER_MM
    return replace(sheet, texture=cv2.GaussianBlur(sheet.texture, (0, 0), blur)), look


def _moire(sheet, look, rng):
    y, x = np.mgrid[: sheet.texture.shape[0], : sheet.texture.shape[1]] / PX_PER_MM
    angle = rng.uniform(0, np.pi)
    wave = 0.16 * np.sin(2 * np.pi * (x * np.cos(angle) + y * np.sin(angle)) / 7.0)
    return replace(sheet, texture=np.clip(sheet.texture + (wave * inked(sheet.texture))[:, :, None], 0.01, 1)), look


def _faded_black(sheet, look, rng):
    return replace(
        sheet, texture=sheet.texture + 0.5 * inked(sheet.texture)[:, :, None] * (0.85 - sheet.texture)
    ), look


def _inverted(sheet, look, rng):
    return replace(sheet, texture=1 - sheet.texture), look


def _wrong(sheet, look, rng):
    return replace(sheet, code=(sheet.code + 1 + int(rng.integers(28))) % 256), look


def _mirrored(sheet, look, rng):
    return replace(sheet, texture=np.ascontiguousarray(sheet.texture[:, ::-1])), look


# Defect, the lines that may name it, and the grades that are right for it.
DEFECTS: dict[str, tuple[Defect, tuple[str, ...], str]] = {
    "scale 0.97": (_scaled, ("scale",), "DF"),
    "X and Y 2 % apart": (_unequal, ("X to Y",), "DF"),
    "faded blue": (_faded_blue, ("contrast of blue", "color of blue"), "CDF"),
    "magenta cast": (_magenta, ("color of blue",), "CDF"),
    "streaks": (_streaks, ("evenness",), "CDF"),
    "margin cut": (_cut_margin, ("white margin",), "CDF"),
    "glare spot": (_glare, ("glare",), "CDF"),
    "low ink": (_low_ink, ("contrast of red", "contrast of blue"), "CDF"),
    "blur": (_blurred, ("sharpness",), "CDF"),
    "moire": (_moire, ("evenness",), "CDF"),
    "wrong for its label": (_wrong, ("content",), "F"),
    "mirrored": (_mirrored, ("content",), "F"),
}
# Of markers in black alone.
TAG_DEFECTS = {
    name: (defect, lines, severity)
    for name, (defect, lines, severity) in DEFECTS.items()
    if name not in ("faded blue", "magenta cast", "low ink")
} | {
    "faded black": (_faded_black, ("contrast of black",), "CDF"),
    "white on black": (_inverted, ("content",), "F"),
}


def defects_of(family: str) -> dict[str, tuple[Defect, tuple[str, ...], str]]:
    return DEFECTS if family.startswith("lm") else TAG_DEFECTS


@lru_cache(maxsize=64)
def drawn(family: MarkerFamily, code: int) -> np.ndarray:
    page = compose_landmark_page(family, code, usual_size_mm(family, SHEET), SHEET)
    rgb = np.asarray(
        pypdfium2.PdfDocument(pages_to_pdf([page], ""))[0].render(scale=2 * DPI / 72).to_pil().convert("RGB")
    )
    height, width = round(PAPER_MM[1] * PX_PER_MM), round(PAPER_MM[0] * PX_PER_MM)
    light = srgb_to_linear(np.arange(256) / 255)[rgb].astype(np.float32)
    return cv2.resize(light, (width, height), interpolation=cv2.INTER_AREA)


def scan(sheet: Sheet, look: Viewing, rng: np.random.Generator) -> np.ndarray:
    """A flatbed: even light, a little blur, noise and turn; the bed's lid is gray."""
    height, width = sheet.texture.shape[:2]
    turn = np.deg2rad(rng.uniform(-0.1, 0.1))
    c, s = np.cos(turn), np.sin(turn)
    A = np.array([[c, -s, 4.0 + rng.uniform(0, 4)], [s, c, 4.0 + rng.uniform(0, 4)]])
    image = cv2.warpAffine(sheet.texture, A, (width + 16, height + 16), flags=cv2.INTER_CUBIC, borderValue=(0.6,) * 3)
    if look.gloss:
        y, x = np.mgrid[: image.shape[0], : image.shape[1]]
        at = (np.array(CENTRE_MM) + rng.uniform(-50, 50, 2)) * PX_PER_MM
        image = (
            image
            + (look.gloss * np.exp(-(np.hypot(x - at[0], y - at[1]) ** 2) / 2 / (12 * PX_PER_MM) ** 2))[:, :, None]
        )
    image = cv2.GaussianBlur(image, (0, 0), look.blur_px)
    code = linear_to_srgb(np.clip(image * 0.97, 0, 1)) * 255 + rng.normal(0, 1.2, image.shape)
    return np.clip(np.round(code), 0, 255).astype(np.uint8)[:, :, ::-1].copy()


def photograph(sheet: Sheet, look: Viewing, rng: np.random.Generator) -> np.ndarray:
    """A hand-held camera an arm's length away."""
    K = np.array([[FOCAL_PX, 0, 799.5], [0, FOCAL_PX, 599.5], [0, 0, 1.0]])
    camera = CameraModel(PHOTO_SIZE, K, np.zeros(5))
    distance = rng.uniform(0.72, 0.85)
    turn = cv2.Rodrigues(np.array([*np.deg2rad(rng.uniform(-15, 15, 2)), np.deg2rad(rng.uniform(-8, 8))]))[0]
    offset = (np.array(CENTRE_MM) - np.array(PAPER_MM) / 2) / 1000
    R = turn @ np.diag([1.0, -1.0, -1.0])
    middle = np.array([rng.uniform(-0.02, 0.02), rng.uniform(-0.02, 0.02), distance])
    t = middle - R @ np.array([offset[0], -offset[1], 0.0])
    size = (PAPER_MM[0] / 1000, PAPER_MM[1] / 1000)
    scene = Scene(
        (Panel(Pose("map", "sheet", R, t), size, sheet.texture.astype(np.float32)),), LandmarkMap([]), (1, 1, 1)
    )
    wall = np.full((PHOTO_SIZE[1], PHOTO_SIZE[0], 3), rng.uniform(0.15, 0.4), dtype=np.float32)
    radiance = render(scene, camera, Pose.identity("map", "camera"), wall)
    gloss = None
    if look.gloss:
        at = camera.project(middle[None] + rng.uniform(-0.05, 0.05, (1, 3)) * [1, 1, 0])[0]
        gloss = Gloss((float(at[0]), float(at[1])), 45.0, look.gloss)
    light = Light(
        brightness=rng.uniform(0.6, 0.85),
        temperature_k=float(rng.uniform(2700, 6500)),
        gradient=tuple(rng.uniform(-0.15, 0.15, 2)),
        gloss=gloss,
    )
    tone = str(rng.choice(["srgb", "gamma"]))
    development = Development(tone=tone, sharpen=float(rng.uniform(0, 0.4)), jpeg_quality=int(rng.integers(85, 96)))
    chain = ImagingChain(Lens(float(rng.uniform(0.5, 0.9))), light, Sensor(9000, 6), development)
    return expose(radiance, chain, rng)


def examine(job: tuple[str, str, int, bool]) -> tuple[str, bool, str, dict[str, str | None]]:
    """(defect, scanned, overall grade, grades by line)."""
    name, defect, seed, scanned = job
    family = family_named(name)
    rng = np.random.default_rng([seed, 4242])
    code = int(rng.integers(min(family.code_count, 256)))
    while defect == "mirrored" and family.mirrored_code(code) == code:
        code = int(rng.integers(min(family.code_count, 256)))
    sheet, look = Sheet(drawn(family, code), code, usual_size_mm(family, SHEET)), Viewing()
    if defect != "none":
        sheet, look = defects_of(name)[defect][0](sheet, look, rng)
    printer = PRINTERS[int(rng.integers(len(PRINTERS)))]
    sheet = replace(sheet, texture=as_printed(sheet.texture.astype(np.float32), printer))
    image = scan(sheet, look, rng) if scanned else photograph(sheet, look, rng)
    found = grade_sheet("", image, (DPI, DPI) if scanned else None, (Stated(sheet.code, family, sheet.size_mm),))
    if not found:
        return defect, scanned, "unread", {}
    item: PrintedLandmark = max(found, key=lambda p: np.ptp(p.observation.corners))
    return defect, scanned, item.grade, {line.name: line.grade for line in item.lines}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=10)
    parser.add_argument("--seed", type=int, default=90000)
    parser.add_argument("--family", default="lm8")
    parser.add_argument("--only", nargs="*", default=None)
    options = parser.parse_args()
    names = options.only or ["none", *defects_of(options.family)]
    jobs = []
    for name in names:
        for k in range(options.n):
            jobs.append((options.family, name, options.seed + k, True))
            jobs.append((options.family, name, options.seed + k, False))
    with ProcessPoolExecutor() as pool:
        answers = list(pool.map(examine, jobs, chunksize=2))
    print(
        "| planted | looked at | n | named by the right line, severity right | grades | other lines at C or worse |"
    )
    print("|---|---|---|---|---|---|")
    for name in names:
        for scanned in (True, False):
            some = [a for a in answers if a[0] == name and a[1] == scanned]
            if not some:
                continue
            grades = Counter(grade for _, _, grade, _ in some)
            answer = ", ".join(f"{grade} {count}" for grade, count in sorted(grades.items()))
            if name == "none":
                right, expected = sum(grade in "AB" for _, _, grade, _ in some), ()
            else:
                expected, severity = defects_of(options.family)[name][1], defects_of(options.family)[name][2]
                right = sum(any((lines.get(line) or "A") in severity for line in expected) for *_, lines in some)
            others = Counter(
                line
                for *_, lines in some
                for line, grade in lines.items()
                if (grade or "A") in "CDF" and line not in expected
            )
            listed = ", ".join(f"{line} {count}" for line, count in others.most_common(6)) or "none"
            print(f"| {name} | {'scan' if scanned else 'photograph'} | {len(some)} | {right} | {answer} | {listed} |")


if __name__ == "__main__":
    main()
