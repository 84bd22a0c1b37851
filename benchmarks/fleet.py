"""Merge of many recordings: seconds and memory of summing and solving synthetic information.

    uv run python benchmarks/fleet.py [--landmarks 10000] [--recordings 10000] [--seen 40]

Landmarks stand on a square grid, a meter apart; each recording sees the ``--seen`` nearest to one, and gives a
random positive definite information matrix of their poses, consistent with true steps away from the linearization.
One landmark is known, as an anchor.  The solution is compared with the true steps.
"""

from __future__ import annotations

import argparse
import resource
import time

import numpy as np
from scipy.spatial import cKDTree

from lmkit.optim.information_sum import InformationSum, unknowns_of

SIZE = 6  # unknowns of a landmark


def main() -> None:
    """Print one line of figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--landmarks", type=int, default=10_000)
    parser.add_argument("--recordings", type=int, default=10_000)
    parser.add_argument("--seen", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    side = int(np.ceil(np.sqrt(arguments.landmarks)))
    places = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)[: arguments.landmarks]
    nearest = cKDTree(places)
    true = rng.normal(0.0, 0.01, SIZE * len(places))
    total = InformationSum(len(places), SIZE)
    centers = rng.permutation(np.resize(np.arange(len(places)), arguments.recordings))
    adding = generating = 0.0
    for center in centers:
        start = time.thread_time()
        rows = np.sort(nearest.query(places[center], min(arguments.seen, len(places)))[1])
        columns = unknowns_of(rows, SIZE)
        A = rng.normal(size=(len(columns), len(columns)))
        H = A @ A.T + np.eye(len(columns))
        b = H @ true[columns]
        middle = time.thread_time()
        total.add(rows, H, b)
        generating, adding = generating + middle - start, adding + time.thread_time() - middle
    total.add(np.array([0]), 1e8 * np.eye(SIZE), 1e8 * true[:SIZE])
    start = time.thread_time()
    found = total.solve()
    solving = time.thread_time() - start
    error = float(np.abs(found - true).max())
    memory_gb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
    print(
        f"{len(places)} landmarks, {arguments.recordings} recordings of {arguments.seen} landmarks: "
        f"summed in {adding:.1f} s, solved in {solving:.1f} s of CPU (made in {generating:.1f} s), "
        f"{memory_gb:.2f} GB at most, largest error {error:.1e}"
    )


if __name__ == "__main__":
    main()
