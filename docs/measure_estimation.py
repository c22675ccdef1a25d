"""Print what not knowing the channel costs, as a table: [CHANNELS], 400 if not given."""

from __future__ import annotations

import sys

from planopt.channel.multipath.multipath_models import Multipath, Rician
from planopt.channel.validation.held_out import GroupedRatio
from planopt.studies.estimation import estimation_study, published_case

SIDES_M = {"fig3": 50.0, "fig4": 100.0}
"""Five decorrelation distances."""

LAWS: dict[str, dict[str, Multipath | None]] = {
    "fig3": {"Gaussian in dB": None, "Rician, K = 10": Rician(10.0)},
    "fig4": {"Gaussian in dB": None, "Rician, K = 30": Rician(30.0)},
}
"""[GM11] gives omega = 1.99 and 1.13, which is Rician K = 10 and 30 (equation 1.5)."""

COLUMNS = (
    "channel",
    "multipath",
    "measurements",
    "oracle's RMSE [dB]",
    "learner",
    "RMSE [dB]",
    "of the oracle's",
    "without multipath",
    "inside 95 % [%]",
)


def main(channels: str = "400") -> None:
    """Run the study on both channels of [GM11], both laws, 102 and 16 measurements."""
    print(f"| {' | '.join(COLUMNS)} |")
    print("|---" * len(COLUMNS) + "|")
    for name, side_m in SIDES_M.items():
        for words, law in LAWS[name].items():
            for measurements in (102, 16):
                case = published_case(name, side_m, law)
                oracle, *rows = estimation_study(case, measurements, int(channels))
                for row in rows:
                    cells = (
                        name,
                        words,
                        str(measurements),
                        f"{oracle.rmse_db.value:.2f}",
                        row.learner,
                        f"{row.rmse_db.value:.2f}",
                        _shown(row.of_oracle, 3),
                        _shown(row.latent_of_oracle, 3),
                        _shown(row.coverage, 1, 100.0),
                    )
                    print(f"| {' | '.join(cells)} |", flush=True)


def _shown(ratio: GroupedRatio, digits: int, scale: float = 1.0) -> str:
    value, low, high = (scale * part for part in (ratio.value, ratio.low, ratio.high))
    return f"{value:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


if __name__ == "__main__":
    main(*sys.argv[1:])
