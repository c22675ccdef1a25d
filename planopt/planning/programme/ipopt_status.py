"""IPOPT's raw return status as a `Termination`, totally.

CasADi's `unified_return_status` hides infeasible and NaN, and `success` includes acceptable points,
so the raw string is mapped. An unknown string is a numerical failure.
"""

from __future__ import annotations

from planopt.planning.plan import Termination

TERMINATIONS: dict[str, Termination] = {
    "Solve_Succeeded": Termination.CONVERGED,
    "Solved_To_Acceptable_Level": Termination.ACCEPTABLE,
    "Infeasible_Problem_Detected": Termination.INFEASIBLE,
    "Search_Direction_Becomes_Too_Small": Termination.NUMERICAL_FAILURE,
    "Diverging_Iterates": Termination.NUMERICAL_FAILURE,
    "User_Requested_Stop": Termination.STOPPED,
    "Feasible_Point_Found": Termination.ACCEPTABLE,
    "Maximum_Iterations_Exceeded": Termination.ITERATION_LIMIT,
    "Restoration_Failed": Termination.NUMERICAL_FAILURE,
    "Error_In_Step_Computation": Termination.NUMERICAL_FAILURE,
    "Maximum_CpuTime_Exceeded": Termination.TIME_LIMIT,
    "Maximum_WallTime_Exceeded": Termination.TIME_LIMIT,
    "Not_Enough_Degrees_Of_Freedom": Termination.NUMERICAL_FAILURE,
    "Invalid_Problem_Definition": Termination.NUMERICAL_FAILURE,
    "Invalid_Option": Termination.NUMERICAL_FAILURE,
    "Invalid_Number_Detected": Termination.NUMERICAL_FAILURE,
    "Unrecoverable_Exception": Termination.NUMERICAL_FAILURE,
    "NonIpopt_Exception_Thrown": Termination.NUMERICAL_FAILURE,
    "Insufficient_Memory": Termination.NUMERICAL_FAILURE,
    "Internal_Error": Termination.NUMERICAL_FAILURE,
}
"""Every status that IPOPT's interface defines."""


def termination_of(return_status: str) -> Termination:
    """Map a raw IPOPT status."""
    return TERMINATIONS.get(return_status, Termination.NUMERICAL_FAILURE)
