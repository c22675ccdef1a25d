"""The worth of a plan is what the loop collects that drives it: one measuring rule for both."""

import numpy as np
import pytest
from terms_scene import LEARNING, context_of, terms_problem

from planopt.channel import measure
from planopt.channel.kriging import predict
from planopt.planning.initial_data import prepare
from planopt.planning.stepping import learn_measured
from planopt.planning.values.local_value import local_value
from planopt.planning.values.objective_value import ObjectiveValue

THRESHOLD_DB2, DECAY_PER_M = 6.0, 0.03


def mapping(form):
    """A mapping term, with the keys that go with its form."""
    term = {"kind": "mapping", "form": form}
    if form == "path":
        term |= {"variance_threshold_db2": THRESHOLD_DB2, "closeness_per_m": DECAY_PER_M}
    return term


TERMS = {kind: {**LEARNING, "criterion": kind} for kind in "TDA"} | {
    form: mapping(form) for form in ("information", "path", "average")
}


def paths(context):
    """One that only sees new places, and those that revisit, stand, and pass by measurements."""
    at = context.position_m
    known = context.posterior.measurements.positions_m
    beside = known[np.linalg.norm(known - at, axis=1).argmin()]
    onward = at + np.array([[1.5, 0.4], [2.9, -0.3], [3.5, 1.2], [4.1, 2.8], [5.0, 4.0]])
    return {
        "new places": onward,
        "standing still": np.tile(at + 1.0, (5, 1)),
        "to and fro": onward[[0, 1, 0, 1, 2]] + 0.01 * np.arange(5)[:, None],
        "over a measurement": np.vstack([onward[:2], beside + 0.1, beside - 0.2, onward[4]]),
        "nothing to measure": np.tile(beside + 0.05, (5, 1)),
    }


def collected(problem, seed, name, path, context):
    """The information gained by driving the path through the loop's own measuring; and how often.

    Nothing of the worth's formulas is in it: information matrices and variances before and after.
    """
    prepared = prepare(problem, seed)
    belief, gained, count, driven = prepared.belief, 0.0, 0, context.position_m
    length = 0.0
    for place in path:
        length += float(np.linalg.norm(place - driven))
        driven = place
        after = learn_measured(
            problem, belief, [measure(truth, place[None]) for truth in prepared.truths]
        )
        for before, later in zip(belief.posteriors, after.posteriors, strict=True):
            if len(later.measurements) == len(before.measurements):
                continue
            variance = predict(before, place[None]).deviation_db[0] ** 2
            if name == "information":
                gained += 0.5 * np.log(variance / before.parameters.multipath_std_db**2)
            if name == "path":
                gained += max(variance - THRESHOLD_DB2, 0.0) * np.exp(-DECAY_PER_M * length)
        count += len(after.posterior.measurements) > len(belief.posterior.measurements)
        belief = after
    region = context.near_region
    for before, after in zip(prepared.belief.posteriors, belief.posteriors, strict=True):
        if name == "average":
            first, last = (predict(p, region.grid_m).deviation_db ** 2 for p in (before, after))
            gained += (first - last) @ region.weight
        m, n = before.theta_covariance, after.theta_covariance
        if name == "T":
            gained += np.trace(np.linalg.inv(n) - np.linalg.inv(m))
        if name == "D":
            gained += np.linalg.slogdet(m)[1] - np.linalg.slogdet(n)[1]
        if name == "A":
            gained += np.trace(m - n)
    return gained, count


@pytest.mark.parametrize("stations", [1, 2])
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", TERMS)
def test_worth_is_what_the_loop_collects(name, seed, stations):
    """Also where a path stands, comes back, or passes by measured places."""
    problem = terms_problem(TERMS[name], stations=stations)
    context, _ = context_of(problem, seed)
    worth, counts = ObjectiveValue(context), {}
    for kind, path in paths(context).items():
        wanted, counts[kind] = collected(problem, seed, name, path, context)
        assert worth(path) == pytest.approx(wanted, rel=1e-6, abs=1e-9)
        assert context.measuring.takes(path).sum() == counts[kind]
    assert counts["standing still"] == 1
    assert counts["nothing to measure"] == 0
    assert counts["new places"] > counts["to and fro"] > 1


@pytest.mark.parametrize("name", TERMS)
def test_what_a_solver_counts_is_the_worth(name):
    """But for places that are within a tenth of the spacing of being measured, or not.

    Within 2 %, for rounded cusps; the path form's threshold gives 3/16 of its width a step.
    """
    context, _ = context_of(terms_problem(TERMS[name]))
    worth = ObjectiveValue(context)
    for path in paths(context).values():
        evaluate = local_value(context, path)
        nothing = np.tile(context.posterior.measurements.positions_m[0], (5, 1))
        found = evaluate(path).value.value - evaluate(nothing).value.value
        near = 0.15 if name == "path" else 0.05
        assert found == pytest.approx(worth(path), rel=0.02, abs=near)
