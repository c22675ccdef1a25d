"""Worlds that several tests look at."""

from pathlib import Path

import pytest

from planopt.world.readers import read_obstacles
from planopt.world.workspace import Workspace


@pytest.fixture(scope="session")
def munich() -> Workspace:
    """The 742 footprints of central Munich."""
    file = Path(__file__).parents[2] / "problems" / "data" / "munich_buildings.json"
    return Workspace((-400.0, -400.0, 400.0, 400.0), read_obstacles(file))
