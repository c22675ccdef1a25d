"""Worlds that several tests look at."""

from pathlib import Path

import pytest

from planopt import Workspace
from planopt.world import read_obstacles


@pytest.fixture(scope="session")
def munich() -> Workspace:
    file = Path(__file__).parents[2] / "problems" / "data" / "munich_buildings.json"
    return Workspace((-400.0, -400.0, 400.0, 400.0), read_obstacles(file))
