"""What imports what, at run time: import-linter (``make imports``) checks the source."""

import re
import subprocess
import sys
from types import ModuleType

import pytest

import planopt

HEAVY = {"casadi", "cvxpy", "matplotlib", "networkx", "sklearn"}
SOLVING = (
    "planopt.planning.candidates",
    "planopt.planning.programme",
    "planopt.planning.reach_planner",
    "planopt.planning.refine",
    "planopt.planning.search",
)
"""Modules and packages that plan."""


def modules_after(statement: str) -> set[str]:
    """Modules that a fresh interpreter has loaded after `statement`."""
    printed = subprocess.run(
        [sys.executable, "-c", f"{statement}\nimport sys\nprint(*sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
    )
    return set(printed.stdout.split())


def test_import_of_package_is_light() -> None:
    loaded = modules_after("import planopt")
    assert {name for name in loaded if name.startswith("planopt")} == {
        "planopt",
        "planopt.lazy_names",
    }
    assert not loaded & {"numpy", *HEAVY}


def test_help_is_light() -> None:
    """Nothing heavy is loaded to print a help page, whose planners are written out."""
    numerics = {"numpy", "pydantic", "rich", "scipy", "shapely"}
    assert not modules_after("import planopt.cli") & (HEAVY | numerics)
    from planopt.commands.options import PLANNERS
    from planopt.problems.settings import OWN

    assert PLANNERS.partition(";")[0].split(", ") == list(OWN)


def test_list_is_light() -> None:
    """Listing the library reads descriptions only: no numerics, no validation of worlds."""
    loaded = modules_after(
        "import contextlib, io\nfrom planopt.cli import main\n"
        "with contextlib.redirect_stdout(io.StringIO()):\n    assert main(['list']) == 0"
    )
    assert not loaded & {"numpy", "shapely", "planopt.problems.schema", *HEAVY}


@pytest.mark.parametrize("module", ["proof.verify", "proof.searches"])
def test_verifier_stands_alone(module: str) -> None:
    """Loading the verifier loads no solver and nothing of the transcription or the search."""
    loaded = modules_after(f"import planopt.planning.{module}")
    assert f"planopt.planning.{module}" in loaded
    assert not loaded & HEAVY
    assert not [name for name in loaded if name.startswith(SOLVING)]


def test_check_plans_nothing() -> None:
    loaded = modules_after("import planopt.planning.check.check")
    assert not loaded & HEAVY
    assert not [name for name in loaded if name.startswith(SOLVING)]


PACKAGES = (planopt, planopt.channel, planopt.extend, planopt.objectives, planopt.problems)
PUBLIC = [(package, name) for package in PACKAGES for name in package.__all__]


@pytest.mark.parametrize(("package", "name"), PUBLIC)
def test_public_name(package: ModuleType, name: str) -> None:
    """Every public name can be had from its package, under its own name."""
    found = getattr(package, name)
    assert found.__name__ in (name, f"{package.__name__}.{name}")
    assert name in dir(package)


def test_public_names_are_few() -> None:
    """Completion shows what most problems need; four packages have the rest; tools get no hints."""
    assert len(planopt.__all__) <= 35
    assert not [name for name in planopt.__all__ if name in planopt.extend.__all__]
    assert len(planopt.channel.__all__) > 40
    with pytest.raises(AttributeError, match=r"'__wrapped__'$"):
        planopt.__wrapped__  # noqa: B018
    assert type(planopt.load("open_field").report) is planopt.problems.ReportSettings


@pytest.mark.parametrize(
    ("package", "name", "hint"),
    [
        (planopt.problems, "ReachObjective", "it is planopt.objectives.ReachObjective"),
        (planopt.channel, "Problem", "it is planopt.Problem"),
        (planopt, "OwnRule", "it is planopt.extend.OwnRule"),
        (planopt.objectives, "problems", "it is planopt.problems"),
        (planopt, "simulte", "did you mean planopt.simulate?"),
        (planopt, "ReachObjectiv", "did you mean planopt.objectives.ReachObjective?"),
        (planopt.extend, "register_planers", "did you mean planopt.extend.register_planner?"),
        (planopt, "no_such_name", "see dir(planopt)"),
    ],
)
def test_unknown_name(package: ModuleType, name: str, hint: str) -> None:
    """It says where the name is, or which is like it, as an attribute and in an import."""
    said = f"^module {package.__name__!r} has no attribute {name!r}: {re.escape(hint)}$"
    with pytest.raises(AttributeError, match=said):
        getattr(package, name)
    with pytest.raises(ImportError, match=said):
        exec(f"from {package.__name__} import {name}")
    assert not hasattr(package, name)
