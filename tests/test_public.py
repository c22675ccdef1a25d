"""The package's public names."""

import pkgutil
from types import ModuleType

import pytest
from refusals import refused

import planopt


@pytest.mark.parametrize(
    "package",
    [
        planopt,
        planopt.channel,
        planopt.extend,
        planopt.objectives,
        planopt.problems,
        planopt.report,
    ],
)
def test_no_public_name_is_a_module(package: ModuleType) -> None:
    """Else importing the module would put it in the place of the function or class."""
    modules = {each.name for each in pkgutil.iter_modules(package.__path__) if not each.ispkg}
    assert not modules & set(package.__all__)


def test_a_refusal_is_an_error_of_no_plan() -> None:
    """It is caught as that one, and has the forbidden routes."""
    assert issubclass(planopt.extend.BlockedError, planopt.NoPlanError)
    error = planopt.extend.BlockedError("no path", ())
    assert error.blocked == ()


def test_every_task_has_the_same_functions() -> None:
    """The same functions take them, say what a task has not, and refuse anything else."""
    pursuit = planopt.load("pursuit_static")
    assert isinstance(pursuit, planopt.problems.TaskProblem)
    assert len(repr(pursuit).splitlines()) <= 5
    assert repr(planopt.simulate(pursuit)).startswith("pursuit_static: captured")
    with refused():
        planopt.solve(pursuit)
    with refused():
        planopt.simulate(pursuit, cost_to_go="geodesic")
    for other in ("pursuit_static", None, planopt.Problem):
        with refused():
            planopt.simulate(other)
