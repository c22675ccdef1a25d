"""Judge saved plans or a saved run of a problem whose objective is a sum of terms.

As for a goal: places come from ``steps.csv``, everything else is computed again from them, the
problem and the seed, the target's way and what every filter knew of it included.
"""

from __future__ import annotations

from planopt.planning.certificate import Certificate
from planopt.planning.check.check_team_plan import check_team_plan
from planopt.planning.check.check_team_run import check_team_run
from planopt.planning.files.read_team import SavedTeam
from planopt.planning.files.team_run_json import TeamRunRecord
from planopt.planning.given import Given


def check_team(saved: SavedTeam, given: Given | None) -> tuple[list[Certificate], list[str]]:
    """The worst certificate of each step, or of all plans, and every reason to reject.

    Parameters
    ----------
    saved
        What was read.
    given
        What problem and seed give, if it is to be had.
    """
    if isinstance(saved.record, TeamRunRecord):
        return check_team_run(saved, saved.record, given)
    return check_team_plan(saved, saved.record, given)


def not_judged(saved: SavedTeam, given: Given | None) -> list[str]:
    """What nothing but planning again could tell, or what is not to be had without the truth."""
    remarks: list[str] = []
    problem = saved.problem
    if any(term.steers for term in problem.terms):
        remarks.append(
            "the ways that a term steers along (steering_m, steering_turns_m) are taken as they "
            "stand"
        )
    if given is None and isinstance(saved.record, TeamRunRecord):
        remarks.append("knowledge.csv is taken as it stands, because there is no truth")
    return remarks
