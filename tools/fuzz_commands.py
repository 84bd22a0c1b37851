"""Run every command on harmed files and options; prints each internal error, the slowest case and the largest memory.

Each case is run unharmed first, and must succeed.  SIGTERM ends the run early, with its counts.

Usage: ``python tools/fuzz_commands.py COUNT [SEED] [WORDS OF THE COMMAND]``.
"""

from __future__ import annotations

import collections
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from command_cases import CASES, run_harmed, run_unharmed, write_inputs

MOST_SHOWN = 40


def main() -> int:
    """Exit code 1 where there is an internal error."""
    count, seed = int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0
    cases = [case for case in CASES if all(word in case.words for word in sys.argv[3:])]
    rng = random.Random(seed)
    codes: collections.Counter[tuple[str, int]] = collections.Counter()
    faults: collections.Counter[str] = collections.Counter()
    slowest: list[tuple[float, str]] = []
    warnings.simplefilter("ignore", RuntimeWarning)
    os.environ.setdefault("LMKIT_JOBS", "1")
    stopped: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: stopped.append(number))
    with tempfile.TemporaryDirectory() as root:
        folder = Path(root) / "inputs"
        ready = os.environ.get("FUZZ_INPUTS")
        if ready:
            shutil.copytree(ready, folder)
        else:
            folder.mkdir()
            write_inputs(folder)
        names = sorted({name for case in CASES for name in case.files})
        inputs = {name: (folder / name).read_bytes() for name in names}
        kept = Path(os.environ.get("FUZZ_KEEP", root + "/kept"))
        (Path(root) / "failed").mkdir()
        os.chdir(folder)
        for case in cases:
            answer = run_unharmed(case, folder, inputs)
            if answer.code != 0:
                print(f"UNHARMED {case.words}\n   {answer.code} {answer.err[-400:]}")
                return 1
        done = 0
        while done < count and not stopped:
            done += 1
            case = rng.choices(cases, [c.weight for c in cases])[0]
            start = time.thread_time()
            answer, what = run_harmed(case, folder, inputs, rng)
            seconds = time.thread_time() - start
            codes[case.name, answer.code] += 1
            slowest = sorted([*slowest, (seconds, what)], reverse=True)[:5]
            bad = answer.code not in (0, 1, 2) or "Traceback" in answer.err or "NaN" in answer.out
            if bad or "Warning:" in answer.err or (answer.code and len(answer.err.splitlines()) > 9):
                key = f"{case.name}: {answer.code} {answer.err[-300:]}"
                if not faults[key] and len(faults) < MOST_SHOWN:
                    print(f"FAULT {what[:300]}\n   {answer.err[-400:]}", flush=True)
                    shutil.copytree(Path(root) / "failed", kept / f"{len(faults)}", dirs_exist_ok=True)
                faults[key] += 1
    for name in sorted({name for name, _ in codes}):
        print(f"{name:60s}", {code: n for (other, code), n in sorted(codes.items()) if other == name})
    total = collections.Counter(dict.fromkeys((0, 1, 2), 0))
    for (_, code), n in codes.items():
        total[code] += n
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    print(f"{done} cases, exit codes {dict(total)}, {sum(faults.values())} faults, at most {memory} MiB")
    for seconds, what in slowest:
        print(f"{seconds:6.2f} s  {what[:160]}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
