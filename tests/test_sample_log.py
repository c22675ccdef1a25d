"""The sample log that ships: it is what its script writes, and shows what its recipes promise."""

import subprocess
import sys
from pathlib import Path

import numpy as np

import planopt
from planopt.problems.library import library_folder

DOCS = Path(__file__).parents[1] / "docs"
LOG = library_folder() / "data" / "munich_walks.csv"


def test_provenance(tmp_path: Path) -> None:
    """The command in the data's README writes the file again."""
    again = tmp_path / "again.csv"
    subprocess.run([sys.executable, DOCS / "sample_log.py", again], check=True, capture_output=True)
    assert again.read_bytes() == LOG.read_bytes()


def test_powers_are_the_maps() -> None:
    """Each is the ray-traced power at its place, but for fading and rounding; floors are marked."""
    log = planopt.channel.read_log(LOG, planopt.channel.LogFormat(censored_column="at_floor"))
    with np.load(LOG.parent / "munich_mast45m.npz") as file:
        gain, x, y = file["path_gain_db"], file["x"], file["y"]
    ix = np.abs(x - log.positions_m[:, :1]).argmin(axis=1)
    iy = np.abs(y - log.positions_m[:, 1:]).argmin(axis=1)
    mean = np.fmax(gain[iy, ix], -130.0) + 30.0
    assert (log.power_dbm[log.censored] == -100.0).all() and log.censored.sum() == 54
    away = (log.power_dbm - mean)[~log.censored]
    assert np.median(np.abs(away)) < 2.0 and np.quantile(np.abs(away), 0.9) < 6.0


def test_recipe_maps_both_contact_and_none() -> None:
    """The README's threshold divides the map: its picture has more than one colour."""
    log = planopt.channel.read_log(LOG, planopt.channel.LogFormat(censored_column="at_floor"))
    fit = planopt.channel.fit_channel(log, planopt.channel.Station((40.0, 0.0), height_m=43.5))
    posterior = planopt.channel.condition(fit.parameters, log)
    maps = planopt.channel.posterior_map(posterior, (-390.0, -360.0, 280.0, 370.0), 10.0, -83.0)
    assert fit.status != "degenerate"
    assert maps.connectivity.values.min() < 0.1 and maps.connectivity.values.max() > 0.9
