"""Closed-loop steps over random scenes: none that the checker rejects, every fallback logged.

``python benchmarks/closed_loop_steps.py --steps 10000 --log FILE`` drives the scenes of seeds 0, 1,
... until so many plans were released, saves each run, judges it from disk, and prints the table.
The log has a line for each run; another call goes on after its last one. Several logs of other
first seeds may be joined into one.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections import Counter
from pathlib import Path
from time import perf_counter

from closed_loop_tally import Tally, drive, summed


def read_log(log: Path) -> list[Tally]:
    """The runs in a log."""
    if not log.exists():
        return []
    tallies: list[Tally] = []
    for line in log.read_text(encoding="utf-8").splitlines():
        data = json.loads(line)
        for name in ("verdicts", "rungs", "outcomes", "unverified"):
            data[name] = Counter(data[name])
        tallies.append(Tally(**data))
    return tallies


def table(tallies: list[Tally]) -> str:
    """Counts by task, then rungs, objections, and every rejection and fault in full."""
    lines = [
        "| task | runs | steps | verified | violated, and so said | rejected | slowest step [s] |",
        "|---|---|---|---|---|---|---|",
    ]
    for task in [*sorted({tally.task for tally in tallies}), "all"]:
        some = [tally for tally in tallies if task in (tally.task, "all")]
        total = summed(some)
        lines.append(
            f"| {task} | {len(some)} | {total.steps} | {total.verdicts['verified']} | "
            f"{total.verdicts['violated']} | {len(total.rejected)} | {total.slowest_s:.2f} |"
        )
    total = summed(tallies)
    lines.append("")
    for name in ("rungs", "outcomes", "unverified"):
        lines += [f"{name}:"]
        lines += [f"  {count:6} {label}" for label, count in getattr(total, name).most_common()]
    slow = [tally for tally in tallies if tally.slowest_s > 2.0]
    lines += [f"slow: seed {tally.seed}, {tally.slowest_s:.2f} s" for tally in slow]
    lines += [f"rejected: {text}" for text in total.rejected]
    lines += [f"fault: {text}" for text in total.faults]
    return "\n".join(lines)


def main() -> None:
    """Drive and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=10_000)
    parser.add_argument("--log", type=Path, required=True)
    parser.add_argument("--first", type=int, default=0, help="first seed of a new log")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after this long")
    chosen = parser.parse_args()
    begun = perf_counter()
    tallies = read_log(chosen.log)
    seed = tallies[-1].seed + 1 if tallies else chosen.first
    while (
        sum(tally.steps for tally in tallies) < chosen.steps
        and perf_counter() - begun < chosen.seconds
    ):
        with tempfile.TemporaryDirectory() as folder:
            tallies.append(drive(seed, Path(folder)))
        with chosen.log.open("a", encoding="utf-8") as file:
            file.write(json.dumps(tallies[-1].to_json()) + "\n")
        seed += 1
    print(table(tallies))


if __name__ == "__main__":
    main()
