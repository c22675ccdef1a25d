"""Judge ``steps.csv``: every cell against the one that the rest of the files gives."""

from __future__ import annotations

from collections.abc import Iterator

from planopt.planning.check.agreement import SHOWN_ALIKE, Disagreement, disagreements
from planopt.planning.files.steps_file import STEPS_FILE, Steps


def steps_reasons(said: Steps, found: Steps) -> list[str]:
    """What in the table is not as found, by row and column; few rows of each column."""
    reasons: list[str] = []
    for name in said.columns:
        if name == "step":  # was counted when it was read
            continue
        alike = list(_column_differences(name, said, found))
        for row, difference in alike[:SHOWN_ALIKE]:
            reasons.append(
                f"{STEPS_FILE}, row {row + 2}, step {said.steps[row]}: {name} is "
                f"{difference.said}, found {difference.found}"
            )
        if len(alike) > SHOWN_ALIKE:
            reasons.append(f"{STEPS_FILE}: {name} differs in {len(alike) - SHOWN_ALIKE} more rows")
    return reasons


def _column_differences(name: str, said: Steps, found: Steps) -> Iterator[tuple[int, Disagreement]]:
    rows = zip(_column(said, name), _column(found, name), strict=True)
    for row, (one, other) in enumerate(rows):
        for difference in disagreements(one, other, name, name):
            yield row, difference


def _column(steps: Steps, name: str) -> list[float] | list[str]:
    if name == "robot":
        return list(steps.robots)
    if name in steps.labels:
        return list(steps.labels[name])
    return {**steps.numbers, **steps.motion}[name].tolist()
