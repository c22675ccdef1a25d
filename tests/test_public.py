"""The package's public names."""

import pkgutil
import subprocess
import sys
from types import ModuleType

import pytest
from refusals import refused

import planopt


def test_every_public_name_is_there() -> None:
    """What `__all__` promises can be imported, and completion shows it."""
    for name in planopt.__all__:
        assert getattr(planopt, name) is not None
    assert set(planopt.__all__) == {name for name in dir(planopt) if not name.startswith("__")}


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


def test_an_unknown_name_is_an_attribute_error() -> None:
    """A slip gives Python's usual error."""
    with pytest.raises(AttributeError, match="no attribute 'slove'"):
        _ = planopt.slove


def test_importing_the_package_imports_nothing_heavy() -> None:
    """``import planopt`` and the command line's own modules stay free of numerics."""
    heavy = "{'numpy', 'scipy', 'casadi', 'cvxpy', 'matplotlib', 'shapely', 'pydantic', 'rich'}"
    code = f"import sys, planopt, planopt.cli; sys.exit(bool({heavy} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_one_plan_by_public_names() -> None:
    """Load, solve, and the verdict, by the words of the contract."""
    problem = planopt.load("open_field")
    solution = planopt.solve(problem, horizon=2)
    assert isinstance(problem, planopt.Problem)
    assert solution.plan.verdict is planopt.Verdict.VERIFIED
    assert isinstance(solution.plan.termination, planopt.extend.Termination)
    assert isinstance(solution.belief.posterior, planopt.channel.ChannelPosterior)


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
