"""What an explanation says to people."""

import pytest

from planopt.planning.explain.explanation import Relaxation


@pytest.mark.parametrize(
    ("key", "words"),
    [
        (
            "constraints.p_min",
            "constraints.p_min = 2 cannot be kept at steps 1-2, 4, short by 3 dB",
        ),
        ("robots[0].speed_max_m_s", "robots[0].speed_max_m_s = 2 stands in the way at steps 1-2"),
        ("planner.horizon", "planner.horizon = 2 stands in the way at steps 1-2, 4, short by 3 dB"),
    ],
)
def test_limits_stand_in_the_way(key, words):
    """What is asked for cannot be kept; nobody asks for a limit to be kept."""
    said = str(Relaxation(key, "", 2.0, (1, 2, 4), 3.0, "dB", 4.0, True, "robot"))
    assert said.startswith(words)
    assert said.endswith("; 4 would do (verified by solving again)")
