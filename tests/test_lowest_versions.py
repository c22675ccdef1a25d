"""The lower bounds of dependencies are the versions that CI tests with."""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def test_lower_bounds_are_tested() -> None:
    """Each requirement of planopt and of its maps is in .ci/lowest.txt, in its lowest version."""
    listed = ROOT / ".ci" / "lowest.txt"
    if not listed.exists():
        pytest.skip("not a checkout")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = [*project["dependencies"], *project["optional-dependencies"]["maps"]]
    lowest = re.findall(r"^(\S+)==(\S+)$", listed.read_text(), re.MULTILINE)
    assert len(lowest) == len(needed)
    for name, version in lowest:
        (bound,) = (text for text in needed if text.startswith(f"{name}>="))
        assert f"{version}.".startswith(bound.removeprefix(f"{name}>=") + ".")
