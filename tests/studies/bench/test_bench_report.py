"""The report's picture and text show the numbers that were scored."""

import numpy as np
from bench_rows import row

from planopt.commands.bench import report_json
from planopt.report import bench_text, draw_bench
from planopt.studies.bench_cases import Manifest
from planopt.studies.bench_references import best_known, reference_of

MANIFEST = Manifest(
    program={"planopt": "0", "source": "0123456789abcdef", "casadi": "3"},
    python="3.11",
    cpu="a processor",
    cores=2,
    tolerances={"objective_share": 0.01},
    problems={"yard": "0"},
)
ROWS = [
    row(planner="a"),
    row(planner="a", seed=1, cpu_s=0.3, rungs={"lattice": 1}),
    row(planner="b", objective=110.0),
    row(planner="b", seed=1, cpu_s=0.2, accepted=False, reasons=("forged",)),
]


def test_picture_has_the_numbers() -> None:
    """Profile, objectives, rates and fallbacks as worked out by hand, with units on the axes."""
    figure = draw_bench(ROWS, best_known({}, ROWS), MANIFEST)
    profile, objective, rates, fallbacks = figure.axes
    solved = {line.get_label(): line.get_ydata()[-1] for line in profile.get_lines()}
    assert solved == {"a": 100.0, "b": 0.0}
    worst = [line.get_xdata()[-1] for line in objective.get_lines()[:2]]
    assert np.allclose(worst, [1e-4, 10.0])
    shown = {line.get_label(): list(line.get_ydata()) for line in rates.get_lines()}
    assert shown == {
        "solved": [100.0, 0.0],
        "verified": [100.0, 100.0],
        "claims that hold": [100.0, 0.0],
    }
    heights = [[bar.get_height() for bar in group] for group in fallbacks.containers]
    assert heights == [[50.0, 100.0], [50.0, 0.0]]
    assert "[%]" in profile.get_ylabel() and "[%]" in objective.get_xlabel()
    assert "[%]" in rates.get_ylabel() and "[%]" in fallbacks.get_ylabel()


def test_text_has_the_numbers() -> None:
    """A line a planner; regressions, rejections and what made the numbers below."""
    known = {one.case: one for one in (reference_of(each, "x") for each in ROWS)}
    known[ROWS[0].case] = reference_of(row(planner="a", objective=90.0), "x")
    data = report_json(MANIFEST, ROWS, known)
    words = bench_text(data)
    lines = {line.split()[0]: line.split() for line in words.splitlines() if line}
    assert lines["a"][1:5] == ["2", "50.0", "50.0", "100.0"]
    assert lines["b"][1:7] == ["2", "0.0", "0.0", "100.0", "1", "0"]
    assert "worse: yard" in words and "objective 100, was 90: 11.1% worse" in words
    assert "rejected: yard" in words and "forged" in words
    assert "a processor, 2 cores" in words and "objective_share 0.01" in words
    assert data["with_reference"] == 4 and data["questions"] == 2
