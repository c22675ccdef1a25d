"""References: regressions in words, and no silent change."""

from dataclasses import replace
from pathlib import Path

import pytest
from bench_rows import row
from refusals import refused

from planopt import InputError
from planopt.bounds.bound import Bound
from planopt.studies.bench_cases import library_cases, library_names, within_bound
from planopt.studies.bench_references import (
    bounds_known,
    fast_cases,
    frozen,
    improvement,
    read_references,
    reference_of,
    regressions,
    write_references,
)

REFERENCE = reference_of(row(), "planopt 0, source 0")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, None),
        ({"objective": 100.9}, None),
        ({"objective": 50.0}, None),
        ({"rungs": {"lattice": 1}}, None),
        ({"objective": 102.0}, "objective 102, was 100: 2.0 % worse"),
        ({"objective": None}, "no objective, was 100"),
        ({"verdict": "feasible_unverified"}, "verdict feasible_unverified, was verified"),
        ({"verdict": "nonsense"}, "verdict nonsense, was verified"),
        ({"outcome": "no_plan"}, "outcome no_plan, was planned"),
        ({"outcome": "error", "reasons": ("ValueError: x",)}, "was planned (ValueError: x)"),
        ({"accepted": False, "reasons": ("a", "b")}, "the check from its files rejects it (a; b)"),
    ],
)
def test_regressions_in_words(changes, words: str | None) -> None:
    """Verdict, objective, outcome and the check; what is as good or better says nothing."""
    found = regressions(row(**changes), REFERENCE)
    if words is None:
        assert found == []
    else:
        assert len(found) == 1 and words in found[0]
        assert found[0].startswith("yard, plan, connected cost-to-go, horizon 10, seed 0, planner")


def test_frozen_names_every_change() -> None:
    """New cases are added; changes have words; what the check rejects is no reference."""
    rows = [row(), row(seed=1, objective=7.123456789123)]
    first, changes = frozen({}, rows, "one")
    assert changes == [] and [one.objective for one in first.values()] == [100.0, 7.12345679]
    again, changes = frozen(first, rows, "two")
    assert changes == [] and again == first
    later, changes = frozen(first, [row(objective=90.0, rungs={"lattice": 1})], "two")
    assert len(changes) == 1 and "objective 100.0 -> 90.0" in changes[0]
    assert "rungs {'plan': 1} -> {'lattice': 1}" in changes[0]
    assert later[row().case].made_by == "two" and len(later) == 2
    bad = [row(seed=2, accepted=False, reasons=("no",)), row(seed=3, outcome="error")]
    same, changes = frozen(first, bad, "two")
    assert same == first and len(changes) == 2 and "left out, no" in changes[0]


@pytest.mark.parametrize(("sense", "tighter", "looser"), [("min", 95.0, 80.0), ("max", 80.0, 95.0)])
def test_frozen_bounds_get_tighter(sense: str, tighter: float, looser: float) -> None:
    """A bound is kept until a tighter one is proven, whatever else changes."""
    known, _ = frozen({}, [row(sense=sense, bound=90.0, gap=0.1)], "one")
    for bound in (looser, None):
        same, changes = frozen(known, [row(sense=sense, bound=bound)], "two")
        assert changes == [] and same == known
    better, changes = frozen(known, [row(sense=sense, bound=tighter, gap=0.05)], "two")
    assert f"bound 90.0 -> {tighter}" in changes[0]
    assert list(bounds_known(known, [row(sense=sense, bound=tighter)]).values()) == [tighter]
    assert [one.gap for one in better.values()] == [0.05]


@pytest.mark.parametrize(("sense", "bound"), [("min", 100.1), ("max", 99.9)])
def test_a_plan_better_than_its_bound_is_rejected(sense: str, bound: float) -> None:
    """The gap has a sign: a bound on the wrong side of a verified plan's cost is a fault."""
    signed = Bound(bound, sense, 100.0)
    assert signed.gap == pytest.approx(-0.001)
    found = row(sense=sense, objective=100.0, bound=bound, gap=signed.gap)
    assert within_bound(found).accepted is False and "bound" in within_bound(found).reasons[-1]
    others = (
        replace(found, gap=-1e-8),
        replace(found, gap=0.1),
        replace(found, verdict="violated"),
    )
    assert all(within_bound(each) == each for each in others)


def test_file_round_trip(tmp_path: Path) -> None:
    """One case a line, sorted, and read as written."""
    file = tmp_path / "references.json"
    made, _ = frozen({}, [row(seed=3), row(), row(planner="scp")], "one")
    write_references(made, file)
    assert read_references(file) == made
    text = file.read_text()
    assert text.count('"problem": "yard"') == 3 and len(text.splitlines()) == 6
    assert text.index('"seed": 0') < text.index('"seed": 3')


def test_library_is_whole() -> None:
    """Every library problem has references of every kind; a missing and a lost one are reported."""
    cases, missing = fast_cases(read_references())
    assert missing == []
    assert {case.question.problem for case in cases} == set(library_names())
    assert {case.question.kind for case in cases} == {"plan", "run"}
    others = {"coverage", "deploy", "drive", "law", "pursuit_design", "receding", "retarget"}
    assert {case.planner for case in cases} == {"auto", "scp", "lattice", *others}
    cases, missing = fast_cases({row().case: REFERENCE})
    assert cases == [] and len(missing) == len(library_names()) + 1
    assert "open_field: no reference" in " ".join(missing)
    assert missing[-1].startswith("yard: has references, but")


def test_cases_are_all_combinations() -> None:
    """Planners that a problem does not allow are left out; one closed loop a problem."""
    cases = library_cases(["open_field", "outdoor_map"], seeds=range(2), horizons=[1, 3])
    field = [case for case in cases if case.question.problem == "open_field"]
    assert len(field) == 2 * 2 * 2 * 4 + 1
    assert {case.planner for case in field} == {"auto", "nlp", "scp", "lattice"}
    mapped = [case for case in cases if case.question.problem == "outdoor_map"]
    assert len(mapped) == 2 * 2 * 10 + 1
    assert len(set(cases)) == len(cases)
    driven = library_cases(["harbour_track"], seeds=[0], run_seeds=[])
    assert {case.planner for case in driven} == {"auto", "nlp", "scp", "lattice"}


@pytest.mark.parametrize(
    ("asked", "key"),
    [
        ({"planners": ["magic"]}, "planners"),
        ({"planners": ["random"]}, "planners"),
        ({"horizons": [0]}, "planner.horizon"),
    ],
)
def test_cases_that_cannot_be(asked, key: str) -> None:
    with pytest.raises(InputError) as caught:
        library_cases(["open_field"], **asked)
    assert caught.value.key == key


def test_what_is_worse_and_what_is_better() -> None:
    """Less of a maximum is worse; a better verdict is no regression; improvements beyond 1 %."""
    reference = replace(REFERENCE, sense="max")
    assert regressions(row(sense="max", objective=102.0), reference) == []
    assert "2.0 % worse" in regressions(row(sense="max", objective=98.0), reference)[0]
    assert regressions(row(), replace(REFERENCE, verdict="feasible_unverified")) == []
    assert regressions(row(), replace(REFERENCE, objective=None)) == []
    assert improvement(row(objective=99.5), REFERENCE) is None
    assert "10.0 % better" in (improvement(row(objective=90.0), REFERENCE) or "")
    assert improvement(row(objective=90.0, accepted=False), REFERENCE) is None


def test_damaged_files(tmp_path: Path) -> None:
    """No JSON, other tables, a negative time, and a case that is there twice."""
    file = tmp_path / "references.json"
    write_references({row().case: REFERENCE}, file)
    line = file.read_text().splitlines()[2]
    twice = file.read_text().replace(line, f"{line},\n{line}")
    write_references({row().case: replace(REFERENCE, cpu_s=-1.0)}, file)
    for text in ("", "[]", '{"references": [{}]}', file.read_text(), twice):
        file.write_text(text)
        with refused():
            read_references(file)
