"""The worst of robots' certificates."""

from planopt.planning.certificate import Certificate, worst_of_robots

GOOD = Certificate(3.0, 0.95, 0.0, None, "exact")
BAD = Certificate(
    1.0, 0.5, 1e-9, 1e-7, "neighbours:512", (1, 3), (2.0, 4.0), (-1.0, -3.0), reasons=("too near",)
)
WORSE = Certificate(2.0, 0.4, 0.0, 1e-8, "exact", (2, 3), (1.0, 5.0), (-0.5, -4.0))


def test_one_robot_keeps_its_own() -> None:
    """Nothing is renamed where there is one robot."""
    assert worst_of_robots({"a": BAD}) is BAD


def test_worst_in_each_respect() -> None:
    """Least clearance and connectivity, largest defects, every missed step once."""
    worst = worst_of_robots({"a": GOOD, "b": BAD, "c": WORSE})
    assert (worst.min_clearance_m, worst.min_connectivity) == (1.0, 0.4)
    assert (worst.dynamics_defect, worst.kkt_residual) == (1e-9, 1e-7)
    assert worst.posterior == "neighbours:512"
    assert worst.relaxed_steps == (1, 2, 3)
    assert worst.relaxation_db == (2.0, 1.0, 5.0)
    assert worst.best_margin_db == (-1.0, -0.5, -4.0)
    assert worst.reasons == ("b: too near",)
