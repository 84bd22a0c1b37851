"""The detection table: lmkit beside AprilTag 3, OpenCV ArUco 4x4 and locus-tag on the same scenes.

    uv run --extra benchmark python benchmarks/detection.py ../shared/data/photos [--n 60] [--plots docs/benchmarks]

Simulated as `planar.py` tells: point spread 0.7 px, gamma, 2500 electrons at full scale, 6 electrons
read noise, one marker of 18 cm in front of a real photograph; every reader sees its own marker in
the same pose with the same background, light and seed.  The sides and blurs at 50 % and 95 % are read off
a monotone fit; intervals are 95 %, from 1000 bootstrap samples of scenes, or Wilson's for rates.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import cv2
import numpy as np
from peers import READERS, wilson
from planar import FOCAL_PX, SIDE_M, View, background, backgrounds, camera, shoot

from lmkit.model.landmark import LM8
from lmkit.model.palette import srgb_to_linear
from lmkit.simulation.photograph import Development, ImagingChain, Lens, Light, Sensor, Shadow

BASE = ImagingChain(Lens(0.7), Light(), Sensor(2500.0, 6.0), Development(tone="gamma"))
LINEARISED = ("AprilTag 3", "ArUco 4x4", "locus-tag")


@dataclass(frozen=True)
class Trial:
    """One kind of image: a ladder's name, its rung, and how to make the view from a seed."""

    ladder: str
    rung: float

    def view(self, seed: int) -> View:
        rng = np.random.default_rng([seed, 77])
        name, value = self.ladder, self.rung
        if name == "side":
            return View(value, 0.0, BASE)
        if name == "side at 45 deg":
            return View(value, 45.0, BASE)
        if name == "tilt":
            return View(60.0, value, BASE)
        if name.startswith("motion"):
            a = rng.uniform(0, np.pi)
            way = (value * float(np.cos(a)), value * float(np.sin(a)))
            return View(float(name.split()[1]), 0.0, replace(BASE, lens=Lens(0.7, motion_px=way)))
        if name == "shadow":
            return View(60.0, 20.0, replace(BASE, light=replace(BASE.light, shadow=Shadow((0, 0), 0.0, value))))
        if name == "contrast":
            # White at 128 + value / 2 code values, black as much under it: little light and a veil.
            white, black = (((128 + s * value / 2) / 255) ** 2.2 for s in (1, -1))
            brightness = (white - black) / 0.86
            return View(60.0, 20.0, replace(BASE, light=Light(brightness, veil=black - 0.02 * brightness)))
        if name == "bayer, JPEG 90":
            sensor, development = replace(BASE.sensor, bayer=True), replace(BASE.development, jpeg_quality=90)
            return View(value, 20.0, replace(BASE, sensor=sensor, development=development))
        if name == "corners":
            return View(value, float(rng.uniform(0, 45)), BASE)
        assert name == "distance"
        return View(FOCAL_PX * SIDE_M / value, float(rng.uniform(20, 45)), BASE)


LADDERS = {
    "side": (8, 9, 10, 11, 12, 13, 14, 15, 16, 18, 20, 22, 24, 27, 30),
    "side at 45 deg": (10, 12, 14, 16, 18, 20, 22, 24, 27, 30, 34),
    "tilt": (60, 65, 68, 70, 72, 74, 76, 78, 80),
    "motion 60": (4, 6, 8, 10, 12, 14, 16, 18, 20),
    "motion 30": (2, 3, 4, 5, 6, 7, 8, 9, 10),
    "shadow": (4, 8),
    "contrast": (8,),
    "bayer, JPEG 90": (20,),
    "corners": (54, 27),
    "distance": (2, 4),
}


@lru_cache(maxsize=1)
def readers() -> dict:
    cv2.setNumThreads(1)
    return {name: reader.make() for name, reader in READERS.items()}


def trial(photos: tuple[Path, ...], only: tuple[str, ...], job: tuple[str, float, int]) -> list[dict]:
    """All readers on one scene."""
    ladder, rung, seed = job
    trial = Trial(ladder, rung)
    shots: dict = {}
    lines = []
    for name, detect in readers().items():
        if only and name not in only:
            continue
        marker = READERS[name].marker
        if marker not in shots:
            shots[marker] = shoot(
                marker, _shadowed(trial.view(seed), seed), background(photos[seed % len(photos)]), seed
            )
        shot = shots[marker]
        line = {"ladder": ladder, "rung": rung, "seed": seed, "reader": name} | _judge(detect(shot.image), shot)
        if ladder in ("corners", "distance") and name in LINEARISED:
            linear = np.round(srgb_to_linear(shot.image / 255) * 255).astype(np.uint8)
            line["linearized"] = _judge(detect(linear), shot)
        lines.append(line)
    return lines


def _shadowed(view: View, seed: int) -> View:
    """The shadow's edge runs across the marker's middle in a random direction."""
    shadow = view.chain.light.shadow
    if shadow is None:
        return view
    from planar import place

    T = place(view, np.random.default_rng(seed))
    ((x, y),) = camera().project(T.t[None])
    edge = replace(shadow, through_px=(x, y), towards_deg=float(np.random.default_rng([seed, 5]).uniform(0, 360)))
    return replace(view, chain=replace(view.chain, light=replace(view.chain.light, shadow=edge)))


def _judge(found: list, shot) -> dict:
    """read, wrong, elsewhere; and the error of corners and translation where it was read."""
    middle, side = shot.corners.mean(axis=0), np.sqrt(cv2.contourArea(shot.corners.astype(np.float32)))
    result: dict = {"read": False, "wrong": 0, "elsewhere": 0}
    for code, corners in found:
        if np.linalg.norm(corners.mean(axis=0) - middle) > 0.6 * side:
            result["elsewhere"] += 1
        elif code != shot.code:
            result["wrong"] += 1
        else:
            result["read"] = True
            result["corner_px"] = float(np.sqrt(np.mean(np.sum((corners - shot.corners) ** 2, axis=1))))
            _, _, t = cv2.solvePnP(
                LM8.object_points(SIDE_M),
                np.ascontiguousarray(corners, dtype=np.float64),
                camera().K,
                None,
                flags=cv2.SOLVEPNP_IPPE_SQUARE,
            )
            result["position_mm"] = 1000 * float(np.linalg.norm(t.ravel() - shot.T_camera_marker.t))
    return result


def crossing(rungs: np.ndarray, hits: np.ndarray, n: np.ndarray, level: float) -> float:
    """Side at which a monotone fit of the rates passes a level; nan where it does not within the ladder.

    Rates that rise with the rung, or fall: the fit follows the ends.
    """
    rates = hits / n
    falling = rates[0] > rates[-1]
    if falling:
        rungs, rates, n = rungs[::-1], rates[::-1], n[::-1]
    # Pool adjacent violators (Ayer et al. 1955).
    blocks: list[list[float]] = []
    for rate, weight in zip(rates, n, strict=True):
        blocks.append([rate, weight, 1])
        while len(blocks) > 1 and blocks[-2][0] > blocks[-1][0]:
            b, a = blocks.pop(), blocks.pop()
            w = a[1] + b[1]
            blocks.append([(a[0] * a[1] + b[0] * b[1]) / w, w, a[2] + b[2]])
    fit = np.concatenate([[rate] * int(count) for rate, _, count in blocks])
    above = np.flatnonzero(fit >= level)
    if len(above) == 0 or above[0] == 0:
        return float(rungs[0]) if len(above) else float("nan")
    k = above[0]
    share = (level - fit[k - 1]) / (fit[k] - fit[k - 1])
    return float(rungs[k - 1] + share * (rungs[k] - rungs[k - 1]))


def crossing_with_interval(lines: list[dict], level: float) -> str:
    """The crossing with its interval: scenes are drawn anew, each with all of its rungs (one place and code)."""
    rungs, seeds = sorted({line["rung"] for line in lines}), sorted({line["seed"] for line in lines})
    read = {(line["seed"], line["rung"]): line["read"] for line in lines}
    reads = np.array([[read[seed, rung] for rung in rungs] for seed in seeds])
    sides, n = np.array(rungs, dtype=float), np.full(len(rungs), len(seeds))
    value = crossing(sides, reads.sum(axis=0), n, level)
    rng = np.random.default_rng(0)
    draws = [
        crossing(sides, reads[rng.integers(len(seeds), size=len(seeds))].sum(axis=0), n, level) for _ in range(1000)
    ]
    if np.isnan(value):
        return "not reached"
    low, high = np.nanpercentile(draws, [2.5, 97.5])
    return f"{value:.1f} ({low:.1f} to {high:.1f})"


def rate(lines: list[dict]) -> str:
    hits, n = sum(line["read"] for line in lines), len(lines)
    low, high = wilson(hits, n)
    return f"{hits / n:.2f} ({low:.2f} to {high:.2f})"


def median_of(key: str, digits: int, lines: list[dict]) -> str:
    plain = [line[key] for line in lines if key in line]
    linear = [line["linearized"][key] for line in lines if key in line.get("linearized", {})]
    text = f"{np.median(plain):.{digits}f}" if plain else "none read"
    return text + (f" (linearized {np.median(linear):.{digits}f})" if linear else "")


ROWS = (
    ("side at 50 % recognition, frontal, px", ("side",), partial(crossing_with_interval, level=0.5)),
    ("side at 95 %", ("side",), partial(crossing_with_interval, level=0.95)),
    ("side at 50 %, tilt 45 deg, px", ("side at 45 deg",), partial(crossing_with_interval, level=0.5)),
    ("side at 95 %, tilt 45 deg", ("side at 45 deg",), partial(crossing_with_interval, level=0.95)),
    ("tilt at 95 %, side 60 px, deg", ("tilt",), partial(crossing_with_interval, level=0.95)),
    ("motion blur at 50 %, side 60 px, px", ("motion 60",), partial(crossing_with_interval, level=0.5)),
    ("motion blur at 50 %, side 30 px, px", ("motion 30",), partial(crossing_with_interval, level=0.5)),
    ("hard shadow 4:1 across it", ("shadow", 4), rate),
    ("hard shadow 8:1 across it", ("shadow", 8), rate),
    ("contrast of 8 code values", ("contrast",), rate),
    ("Bayer, JPEG 90 (4:2:0), side 20 px", ("bayer, JPEG 90",), rate),
    ("corner error, side 54 px, px", ("corners", 54), partial(median_of, "corner_px", 3)),
    ("corner error, side 27 px, px", ("corners", 27), partial(median_of, "corner_px", 3)),
    ("position error at 2 m, mm", ("distance", 2), partial(median_of, "position_mm", 1)),
    ("position error at 4 m, mm", ("distance", 4), partial(median_of, "position_mm", 1)),
)


def print_table(lines: list[dict], names: list[str]) -> None:
    print("| | " + " | ".join(names) + " |\n|---|" + "---|" * len(names))
    for title, (ladder, *rung), summary in ROWS:
        chosen = [line for line in lines if line["ladder"] == ladder and (not rung or line["rung"] == rung[0])]
        cells = [summary([line for line in chosen if line["reader"] == name]) for name in names]
        print(f"| {title} | " + " | ".join(cells) + " |")
    for title, key in (("wrong codes", "wrong"), ("false positives beside the marker", "elsewhere")):
        of = [[line for line in lines if line["reader"] == name] for name in names]
        print(f"| {title} | " + " | ".join(f"{sum(x[key] for x in ls)} in {len(ls)}" for ls in of) + " |")


def print_photographs(photos: list[Path], names: list[str]) -> None:
    found = dict.fromkeys(names, 0)
    for path in photos:
        image = cv2.imread(str(path))
        for name in names:
            found[name] += len(readers()[name](image))
    print(f"| false positives on {len(photos)} photographs | " + " | ".join(str(found[n]) for n in names) + " |")


def print_times(photos: list[Path], names: list[str]) -> None:
    """Median time an image, as a ratio to ArUco, on photographs with two markers of each kind."""
    for label, size in (("VGA", (640, 480)), ("720p", (1280, 720)), ("1080p", (1920, 1080))):
        seconds: dict[str, list[float]] = {name: [] for name in ("ArUco 4x4", *names)}
        for k, path in enumerate(photos[:12]):
            shots = {
                m: cv2.resize(
                    shoot(m, View(60.0, 30.0, BASE), background(path), k).image, size, interpolation=cv2.INTER_CUBIC
                )
                for m in {READERS[n].marker for n in seconds}
            }
            for name in seconds:
                image = shots[READERS[name].marker]
                start = time.perf_counter()
                readers()[name](image)
                seconds[name].append(time.perf_counter() - start)
        medians = {name: np.median(s) for name, s in seconds.items()}
        cells = [f"{medians[n] / medians['ArUco 4x4']:.2f}" for n in names]
        print(
            f"| time, {label}, ratio to ArUco 4x4 ({1000 * medians['ArUco 4x4']:.1f} ms) | "
            + " | ".join(cells)
            + " |"
        )


def plot(lines: list[dict], names: list[str], folder: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    titles = {
        "side": "side, px (frontal)",
        "side at 45 deg": "side, px (tilt 45°)",
        "tilt": "tilt, ° (side 60 px)",
        "motion 60": "motion blur, px (side 60 px)",
        "motion 30": "motion blur, px (side 30 px)",
    }
    figure, axes = plt.subplots(1, len(titles), figsize=(17, 3.4), sharey=True, layout="constrained")
    for axis, (ladder, title) in zip(axes, titles.items(), strict=True):
        for name, style in zip(names, ("-o", "--s", "--^", "--d"), strict=False):
            chosen = [line for line in lines if line["ladder"] == ladder and line["reader"] == name]
            rungs = sorted({line["rung"] for line in chosen})
            rates = [np.mean([line["read"] for line in chosen if line["rung"] == rung]) for rung in rungs]
            axis.plot(rungs, rates, style, label=name, markersize=4, linewidth=1.4)
        axis.set_xlabel(title)
        axis.grid(alpha=0.3)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("share read")
    axes[0].legend(frameon=False, fontsize=9)
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "detection.png", dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("photos", type=Path)
    parser.add_argument("--n", type=int, default=60, help="scenes a rung")
    parser.add_argument("--ladders", nargs="*", default=list(LADDERS))
    parser.add_argument("--readers", nargs="*", default=list(READERS))
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("--plots", type=Path)
    parser.add_argument("--lines", type=Path, help="write every trial as a JSON line")
    parser.add_argument("--jobs", type=int, help="processes; as many as processors unless given")
    options = parser.parse_args()
    photos = backgrounds(options.photos)
    jobs = [
        (ladder, rung, options.seed + k)
        for ladder in options.ladders
        for rung in LADDERS[ladder]
        for k in range(options.n)
    ]
    work = partial(trial, tuple(photos), tuple(options.readers))
    # Spawned, not forked: OpenCV's threads do not survive a fork.
    with ProcessPoolExecutor(options.jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        lines = [line for some in pool.map(work, jobs, chunksize=8) for line in some]
    if options.lines:
        options.lines.write_text("".join(json.dumps(line) + "\n" for line in lines))
    print_table([*lines], options.readers) if set(options.ladders) == set(LADDERS) else _print_rates(lines, options)
    if set(options.ladders) == set(LADDERS):
        print_photographs(photos, options.readers)
        print_times(photos, options.readers)
    if options.plots:
        plot(lines, options.readers, options.plots)


def _print_rates(lines: list[dict], options: argparse.Namespace) -> None:
    for ladder in options.ladders:
        for name in options.readers:
            chosen = [line for line in lines if line["ladder"] == ladder and line["reader"] == name]
            rates = [np.mean([x["read"] for x in chosen if x["rung"] == rung]) for rung in LADDERS[ladder]]
            print(ladder, name, " ".join(f"{rung:g}:{r:.2f}" for rung, r in zip(LADDERS[ladder], rates, strict=True)))
            for key in ("corner_px", "position_mm"):
                per = [[x[key] for x in chosen if x["rung"] == rung and key in x] for rung in LADDERS[ladder]]
                print("   ", key, " ".join(f"{np.median(p):.3f}" if p else "-" for p in per))


if __name__ == "__main__":
    main()
