"""Settings of a problem: target, planner, report and comparison; the registry of planners."""

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import Annotated, Any, Literal, cast

from pydantic import AfterValidator, BeforeValidator, Field, Strict
from pydantic_core import PydanticCustomError

from planopt.errors import InputError
from planopt.keys import Name, Pair, Part
from planopt.parts import Registry, part_of, parts_of

GROUP = "planopt.planners"  # Entry-point group of external planners

_HOME = "planopt.planning.planners"
_SEARCH = "planopt.planning.horizon_planner"


@dataclass(frozen=True)
class PlannerKind:
    """Type of planner that problems can select by name.

    Attributes
    ----------
    name
        Value of the key ``planner.name``.
    make
        Factory, or its import path ``module:name``. It takes the problem of one robot, its geometry
        and a random number generator, and returns an object with the method ``plan`` of
        :class:`planopt.planning.planners.Planner`.
    reaches_goals
        True if the planner supports the task ``reach``. If its path is not verified or does not
        move, planopt's lattice path is released. Robots must be single integrators.
    has_dynamics
        True if the planner supports dynamics other than the single integrator.
    foresees
        True if the planner knows the ground truth and serves as a performance bound. ``make`` then
        takes the problem of all robots, the first station's ground truth and the target's path, and
        returns the paths of all robots for the whole run.
    tracks
        True if the planner supports only target tracking.
    version
        Version of an external planner; studies do not reuse recorded results of other versions.
    """

    name: str
    make: Callable[..., Any] | str
    reaches_goals: bool = False
    has_dynamics: bool = False
    foresees: bool = False
    tracks: bool = False
    version: str = ""

    def maker(self) -> Callable[..., Any]:
        """Return the factory of the planner; raise an `InputError` if it cannot be imported."""
        make = self.make
        if isinstance(make, str):
            module, _, attribute = make.partition(":")
            try:
                make = getattr(import_module(module), attribute)
            except (ImportError, AttributeError, ValueError) as error:
                raise InputError(
                    f'is "{self.name}", registered as {self.make!r}, which cannot be imported '
                    f"({error})",
                    key="planner.name",
                    remedy="correct the registration, install what is missing, or choose another",
                ) from None
        if not callable(make):
            raise InputError(
                f"is of type {type(make).__name__} for {self.name!r}, should be a class or "
                "function",
                key="PlannerKind.make",
                remedy="give the class of the planner (not an instance), or 'module:name'",
            )
        return make


OWN = {
    kind.name: kind
    for kind in (
        *(
            PlannerKind(name, f"{_SEARCH}:HorizonPlanner", reaches_goals=True, has_dynamics=True)
            for name in ("auto", "nlp", "scp", "lattice")
        ),
        PlannerKind("one_step", f"{_HOME}:OneStepPlanner"),
        PlannerKind("largest_deviation", f"{_HOME}:largest_deviation_planner"),
        PlannerKind("random", f"{_HOME}:RandomPlanner"),
        PlannerKind("random_disk", f"{_HOME}:disk_walk_planner"),
        PlannerKind("random_persistent", f"{_HOME}:persistent_walk_planner"),
        PlannerKind("lawnmower", f"{_HOME}:LawnmowerPlanner"),
        PlannerKind("path_loss_only", f"{_HOME}:path_loss_planner", tracks=True),
        PlannerKind("informed_disk", f"{_HOME}:disk_planner", tracks=True),
        PlannerKind("unaware", f"{_HOME}:unaware_planner", tracks=True),
        PlannerKind("oracle", f"{_HOME}:oracle_paths", foresees=True),
        PlannerKind("oracle_log", f"{_HOME}:oracle_log_paths", foresees=True),
        PlannerKind("clairvoyant", f"{_HOME}:clairvoyant_paths", foresees=True),
        PlannerKind("clairvoyant_log", f"{_HOME}:clairvoyant_log_paths", foresees=True),
    )
}
"""Built-in planners. From ``one_step`` on they are baselines without goals, for single integrators
only. The last four are performance bounds for tracking, infeasible for real robots."""

PLANNERS = Registry("a planner", "planner.name", OWN, GROUP)


def register_planner(kind: PlannerKind) -> None:
    """Register an external planner for this process and the workers of its studies.

    Parameters
    ----------
    kind
        Planner to register; it replaces a planner registered under the same name.

    Raises
    ------
    InputError
        The argument is not a PlannerKind, or its name is not a word or belongs to a built-in
        planner.

    Examples
    --------
    >>> from planopt.problems.settings import (
    ...     PlannerKind, planner_names, register_planner, unregister_planner
    ... )
    >>> register_planner(PlannerKind("mine", "my_package.planner:MyPlanner"))
    >>> "mine" in planner_names()
    True
    >>> unregister_planner("mine")
    """
    remedy = "give PlannerKind(name, class), such as PlannerKind('mine', MyPlanner)"
    part_of("kind", kind, PlannerKind, remedy)
    if not isinstance(kind.make, str):
        kind.maker()
    PLANNERS.add(kind.name, kind, key="name")


def unregister_planner(name: str) -> None:
    """Remove a registered planner, if it exists."""
    PLANNERS.registered.pop(name, None)


def planner_names() -> tuple[str, ...]:
    """Return the names of all planners, built-in ones first."""
    return PLANNERS.names()


def planner_kind(name: str) -> PlannerKind:
    """Return the type of planner with a name."""
    found = PLANNERS.find(name)
    if name in OWN or name in PLANNERS.registered:
        return found
    kind = found if isinstance(found, PlannerKind) else PlannerKind(name, found)
    package = getattr(PLANNERS.installed[name], "dist", None)
    version = kind.version or getattr(package, "version", "")
    return replace(kind, name=name, version=version)


def names_with(trait: str) -> str:
    """Return the names of the built-in planners with a trait, as text."""
    *first, last = [name for name, kind in OWN.items() if getattr(kind, trait)]
    return f"{', '.join(first)} or {last}"


MIN_HORIZON, MAX_HORIZON = 1, 500

Coordination = Literal["joint", "decoupled"]


def known_planner(name: str) -> str:
    """Return the name of a planner; raise a validation error for an unknown name."""
    known = planner_names()
    if name not in known:
        listed = ", ".join(f"'{each}'" for each in known[:-1])
        raise PydanticCustomError(
            "planner_name", "Input should be {names}", {"names": f"{listed} or '{known[-1]}'"}
        )
    return name


@dataclass(frozen=True, kw_only=True)
class PlannerSettings(Part):
    """Planner settings."""

    at = "planner"

    step_s: Annotated[float, Field(gt=0, le=1e4)]
    """Duration of a step in seconds."""
    name: Annotated[
        str,
        AfterValidator(known_planner),
        Field(
            examples=list(OWN),
            description="nlp (lattice search, refinement by IPOPT), scp (refinement by sequential "
            "convex programming), auto (same as nlp), lattice (no refinement); for tasks other "
            "than reach also a baseline: "
            f"{', '.join(name for name, kind in OWN.items() if not kind.reaches_goals)}; or a "
            "registered planner.",
        ),
    ] = "auto"
    horizon: Annotated[int, Field(ge=MIN_HORIZON, le=MAX_HORIZON)] = 10
    """Horizon N in steps."""
    neighbours: Annotated[int, Field(ge=4, le=512)] = 48
    """Number of nearest measurements on which the solver conditions each stage."""
    max_steps: Annotated[int, Field(ge=1, le=100_000)] = 400
    """Maximum number of steps of a closed-loop run."""
    budget_s: Annotated[float | None, Field(gt=0, le=1e6)] = None
    """Computing time of a plan in seconds: local refinement ends early enough for verification;
    default: no limit."""
    coordination: Coordination = "joint"
    """Coordination of several robots: joint (each robot accounts for the others' planned
    measurements and maximises its additional gain) or decoupled (each plans as if alone)."""
    rounds: Annotated[int, Field(ge=1, le=10)] = 1
    """Number of rounds in which the robots of a joint team plan in turn in one step; later rounds
    take time and never decrease the team's objective."""


@dataclass(frozen=True)
class ReportSettings(Part):
    """Report settings."""

    at = "report"

    figures: bool = True
    """True if figures are drawn."""


Packets = Literal["measurements", "estimates"]
"""Content of a packet about the target to the base station."""
LEAST_STD = 1e-6
"""Minimum standard deviation of an initial estimate (m or m/s), for finite information."""


@dataclass(frozen=True, kw_only=True)
class Target(Part):
    """Moving target and its initial estimate (equation 4.7)."""

    at = "targets[]"

    name: Name = "target"
    """Name in outputs."""
    start_m: Pair
    """True initial position [x, y] in metres."""
    velocity_m_s: Pair
    """True initial velocity [x, y] in m/s."""
    acceleration_std_m_s2: Annotated[float, Field(ge=0, le=1e6)] = 0.03
    """Standard deviation of the white acceleration along each axis in m/s^2."""
    position_std_m: Annotated[float, Field(ge=LEAST_STD, le=1e6)] = 1.0
    """Standard deviation of the initial position estimate in metres."""
    velocity_std_m_s: Annotated[float, Field(ge=LEAST_STD, le=1e6)] = 0.3
    """Standard deviation of the initial velocity estimate in m/s."""
    start_distance_m: Annotated[float | None, Field(ge=0, le=1e6)] = None
    """Optional distance in metres of the start from start_m, in a direction drawn with the random
    seed; the target then moves away from start_m at the speed of velocity_m_s."""
    heading_spread_rad: Annotated[float, Field(ge=0, le=3.2)] = 0.0
    """Maximum random deviation in rad of the initial heading from that direction."""
    stays_free: bool = False
    """True if paths that leave the bounds or enter obstacles are drawn again."""
    packets: Packets = "measurements"
    """Content of packets: measurements (the robot's last measurement of the target) or estimates
    (the robot's own estimate, which contains the information of all its measurements)."""
    packet_delay_steps: Annotated[int, Field(ge=0, le=1000)] = 0
    """Delay of packets to the station in steps."""


DEFAULT_SEEDS, MOST_SEEDS = 30, 1_000_000  # Default and maximum number of seeds
OF_NO_RUN = ("compare", "problem", "report")
"""Tables of a problem file that cannot be swept, because they do not affect a run."""


def known_seeds(given: object) -> object:
    """Return a number or range of seeds; raise a validation error if it is invalid."""
    is_text = isinstance(given, str) and ":" in given
    if is_text or (isinstance(given, int) and not isinstance(given, bool)):
        with contextlib.suppress(InputError):
            if len(seeds_of(cast("str | int", given))) <= MOST_SEEDS:
                return given
    raise PydanticCustomError(
        "seeds",
        "should be a number of seeds from 1 to {most}, or a range such as 100:200",
        {"most": f"{MOST_SEEDS:_}".replace("_", ",")},
    )


def require_swept(key: str, at: str | None = None) -> None:
    """Raise an `InputError` if a key of the problem file cannot be swept."""
    table = key.partition(".")[0].partition("[")[0]
    if table in OF_NO_RUN:
        raise InputError(
            "cannot be swept" if at is None else f"has {key}, which cannot be swept",
            key=key if at is None else at,
            remedy="choose a key that affects plans, such as constraints.p_min; the option for "
            "seeds is separate",
        )


@dataclass(frozen=True, kw_only=True)
class SettingGroup(Part):
    """Group of settings of a comparison: the Cartesian product of all lists."""

    at = "compare.settings[]"

    # Values that replace those of the problem; an empty list keeps the problem's value
    horizons: Annotated[tuple[int, ...], Strict(False)] = ()
    """Horizons in steps; default: the problem's own."""
    planners: Annotated[tuple[str, ...], Strict(False)] = ()
    """Names of planners; default: the problem's own."""
    costs_to_go: Annotated[tuple[str, ...], Strict(False)] = ()
    """Costs-to-go (geodesic, connected); default: both for problems with a goal."""
    # Values of other keys of the problem file by dotted key
    sweep: Mapping[str, Annotated[list[Any], Field(min_length=1)]] | None = field(
        default=None, hash=False
    )
    """Lists of values for any keys of this file, e.g. { "constraints.p_min" = [0.5, 0.8] }."""


@dataclass(frozen=True, kw_only=True)
class ComparisonSettings(Part):
    """Default settings of ``planopt compare``."""

    at = "compare"

    # Number of random seeds, or a half-open range such as 100:120
    seeds: Annotated[
        Annotated[int, Field(ge=1, le=MOST_SEEDS)]
        | Annotated[str, Field(pattern=r"^\d{1,9}:\d{1,9}$")],
        BeforeValidator(known_seeds),
    ] = DEFAULT_SEEDS
    """Number of random seeds (30 means 0 to 29), or a range ("100:120" means 100 to 119)."""
    # Groups of settings in sequence; the first one is the reference of the comparison
    settings: Annotated[
        tuple[SettingGroup, ...], Strict(False), Field(min_length=1, max_length=100)
    ]
    """Groups of settings in sequence; the first setting is the reference of the paired
    comparison."""

    def __post_init__(self) -> None:
        remedy = "give groups, [SettingGroup(horizons=[1, 10])]"
        groups = parts_of("compare.settings", cast("object", self.settings), SettingGroup, remedy)
        object.__setattr__(self, "settings", groups)
        super().__post_init__()

    def fault(self) -> str | None:
        """Return None if all keys can be swept; raise an `InputError` otherwise."""
        for number, group in enumerate(self.settings):
            for key in group.sweep or {}:
                require_swept(key, f"compare.settings[{number}].sweep")
        return None


def seeds_of(text: str | int, key: str = "seeds") -> range:
    """Return the range of seeds for a count or a half-open range such as ``100:200``."""
    begin, colon, end = str(text).partition(":")
    try:
        chosen = range(int(begin), int(end)) if colon else range(int(begin))
    except ValueError:
        chosen = range(0)
    if len(chosen) == 0 or chosen[0] < 0:
        raise InputError(
            f"is {text!r}, should be a number of seeds or a range",
            key=key,
            remedy="write 30, or 100:200 for the seeds 100 to 199",
        )
    return chosen
