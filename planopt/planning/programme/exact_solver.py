# pyright: basic
"""An IPOPT solver that is given exact derivatives instead of finding them itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca


@dataclass(frozen=True)
class ExactNlp:
    """Objective (minimised) and rows with their derivatives, CasADi expressions all.

    Attributes
    ----------
    x, p
        Variables and parameters.
    lam_f, lam_g
        Weight of the objective and multipliers of the rows.
    f, g
        Objective and rows.
    gradient, jacobian
        Of objective and rows.
    hessian
        Upper triangle of that of ``lam_f f + lam_g . g``.
    """

    x: Any
    p: Any
    lam_f: Any
    lam_g: Any
    f: Any
    g: Any
    gradient: Any
    jacobian: Any
    hessian: Any


def exact_solver(name: str, nlp: ExactNlp, options: dict[str, Any]) -> Any:
    """Build the solver, with IPOPT's `options`."""
    x, p = nlp.x, nlp.p
    # The solver asks these two for derivatives only; values here would be computed for nothing.
    no_f, no_g = ca.MX.nan(1), ca.MX.nan(nlp.g.numel())
    derivatives = {
        "grad_f": ca.Function(
            "nlp_grad_f", [x, p], [no_f, nlp.gradient], ["x", "p"], ["f", "grad_f_x"]
        ),
        "jac_g": ca.Function(
            "nlp_jac_g", [x, p], [no_g, nlp.jacobian], ["x", "p"], ["g", "jac_g_x"]
        ),
        "hess_lag": ca.Function(
            "nlp_hess_l",
            [x, p, nlp.lam_f, nlp.lam_g],
            [nlp.hessian],
            ["x", "p", "lam_f", "lam_g"],
            ["triu_hess_gamma_x_x"],
        ),
    }
    return ca.nlpsol(name, "ipopt", {"x": x, "p": p, "f": nlp.f, "g": nlp.g}, options | derivatives)
