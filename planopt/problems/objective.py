"""What a problem asks for: a goal, or a weighted sum of terms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

CostToGo = Literal["geodesic", "connected"]


TrackingForm = Literal["additive", "information", "covariance", "sampled"]


LearningCriterion = Literal["T", "D", "A", "V"]


MappingForm = Literal["two_layer", "path", "information", "average"]


@dataclass(frozen=True)
class ReachObjective:
    """Reach the goal in least time and effort, out of contact as little as that is worth.

    The cost is the integral of ``1 + effort_weight * speed**2`` until arrival, in seconds. A metre
    driven where the probability of connection P is below p_min counts ``1 + outage_price (1 - P)``
    metres.

    Attributes
    ----------
    effort_weight_s2_m2
        Seconds of travel that one second at 1 m/s is worth, in s^2/m^2.
    cost_to_go
        What the way beyond the horizon costs: ``geodesic`` (shortest way round the obstacles) or
        ``connected`` (cheapest path at the outage price).
    outage_price
        What a metre that is certainly out of contact costs besides, in metres (a number).
    """

    effort_weight_s2_m2: float
    cost_to_go: CostToGo
    outage_price: float = 10.0


@dataclass(frozen=True)
class TrackingTerm:
    """Information on the target that the packets of a path bring (equations 4.11 to 4.13).

    A packet sent at distance r of the target's predicted position has the information 1 / g(r),
    ``g(r) = noise_curvature (r - sweet_spot_m)^2 + noise_floor_m2``.

    Attributes
    ----------
    weight
        In the sum of terms.
    noise_curvature, noise_floor_m2, sweet_spot_m
        varpi, nu (m^2) and r_s of equation 4.8.
    form
        ``additive``: P(connected) / g(r) of each step. The others follow the station's
        filter: ``information`` bounds the expected gain of information from above, ``covariance``
        removes covariance as if losses were independent in time, ``sampled`` averages over joint
        losses.
    """

    weight: float
    noise_curvature: float
    noise_floor_m2: float
    sweet_spot_m: float
    form: TrackingForm = "additive"


@dataclass(frozen=True)
class LearningTerm:
    """Information on path loss gathered along the path (equations 4.1 and 4.2).

    Attributes
    ----------
    weight
        In the sum of terms.
    criterion
        ``T`` (trace, as in [GM11]), ``D``, ``A`` or ``V`` (prediction over the workspace).
    """

    weight: float
    criterion: LearningCriterion


@dataclass(frozen=True)
class MappingTerm:
    """Uncertainty of the channel removed along the path (equations 4.3 to 4.6).

    Attributes
    ----------
    weight
        In the sum of terms.
    form
        ``two_layer`` (steer to the maximiser of J_CH), ``path`` (J_CH summed along the
        path), ``information`` or ``average`` (over the workspace).
    variance_threshold_db2
        sigma_TH^2 in dB^2.
    closeness_per_m
        zeta of ``psi(d) = exp(-zeta d)``.
    """

    weight: float
    form: MappingForm
    variance_threshold_db2: float
    closeness_per_m: float


@dataclass(frozen=True)
class MotionEnergyTerm:
    """Energy of motion, a cost (equation 4.14): k1 |v| + k2 while moving, in joules.

    Attributes
    ----------
    weight
        In the sum of terms, per joule; the energy is subtracted.
    per_metre_j_m, power_w
        k1 and k2.
    """

    weight: float
    per_metre_j_m: float
    power_w: float


@dataclass(frozen=True)
class UntilConnectedTerm:
    """Expected distance until connected, a cost (equation 4.16).

    Attributes
    ----------
    weight
        In the sum of terms, per metre; the distance is subtracted.
    beyond_m
        Metres that the search is expected to go on for where the place that the robot is steered
        to is not connected; None: estimated from what is believed.
    """

    weight: float
    beyond_m: float | None = None


@dataclass(frozen=True)
class TransmissionEnergyTerm:
    """Expected energy of sending some bits at the end of every step, a cost (equation 4.15).

    Attributes
    ----------
    weight
        In the sum of terms, per joule; the energy is subtracted.
    bits, bandwidth_hz
        Bits a step, and symbols a second.
    bits_per_symbol, bit_error_rate, noise_dbm
        As in :class:`planopt.objectives.energy.Radio`.
    """

    weight: float
    bits: float
    bandwidth_hz: float
    bits_per_symbol: float
    bit_error_rate: float
    noise_dbm: float


@dataclass(frozen=True)
class CasadiTerm:
    """A user's own value of a path, written by :func:`planopt.casadi_term`.

    Attributes
    ----------
    weight
        In the sum of terms.
    steps
        The horizon that it is for.
    program
        Its instructions (:mod:`planopt.objectives.expression`).
    """

    weight: float
    steps: int
    program: str


Term = (
    TrackingTerm
    | LearningTerm
    | MappingTerm
    | MotionEnergyTerm
    | UntilConnectedTerm
    | TransmissionEnergyTerm
    | CasadiTerm
)


def steers(term: Term) -> bool:
    """Whether a term steers along a way, whose end is found before a plan is made."""
    two_layer = isinstance(term, MappingTerm) and term.form == "two_layer"
    return two_layer or isinstance(term, UntilConnectedTerm)


@dataclass(frozen=True)
class TermsObjective:
    """A weighted sum of named terms over the horizon, to be maximised.

    Attributes
    ----------
    terms
        At least one; the first is the task's.
    """

    terms: tuple[Term, ...]
