"""The examples in docstrings run, and the functions that users meet first have one."""

import doctest
import importlib
from pathlib import Path

import pytest

import planopt
from planopt.channel import fit_channel, posterior_map

PACKAGE = Path(planopt.__file__).parent
MODULES = sorted(
    ".".join(("planopt", *file.relative_to(PACKAGE).with_suffix("").parts))
    for file in PACKAGE.rglob("*.py")
    if ">>> " in file.read_text()
)


@pytest.mark.usefixtures("own_parts")
@pytest.mark.parametrize("name", MODULES)
def test_examples_run(name: str) -> None:
    found = doctest.testmod(importlib.import_module(name), verbose=False)
    assert found.attempted > 0 and found.failed == 0


@pytest.mark.parametrize(
    "function",
    [
        planopt.load,
        planopt.solve,
        planopt.simulate,
        planopt.compare,
        planopt.Planner.step,
        fit_channel,
        posterior_map,
    ],
    ids=lambda function: function.__qualname__,
)
def test_first_functions_have_an_example(function: object) -> None:
    """The functions of the first pages of the manual show how they are called."""
    assert ">>> " in (function.__doc__ or "")
