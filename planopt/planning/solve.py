"""Functions that solve and simulate a problem, and the planner for a user's own loop.

The seed determines ground truth, first measurements, target path and sensor noise.
"""

import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, Self, overload

import numpy as np
from numpy.typing import ArrayLike

from planopt.arrays import Floats, Mask, finite_array, proof_seconds
from planopt.channel.cholesky import one_blas_thread
from planopt.channel.measurements import Measurements
from planopt.channel.posterior import Belief
from planopt.errors import InputError
from planopt.parts import calling, parts_of
from planopt.planning.free_space import with_drawn_starts
from planopt.planning.initial_data import (
    Prepared,
    UserMeasurements,
    measurements_by_station,
    prepare,
    team_seeds,
    with_measurements,
)
from planopt.planning.loop.drive import drive, true_world
from planopt.planning.loop.results import Run, Solution
from planopt.planning.plan import Plan
from planopt.planning.scene import Scene, build_scenes
from planopt.planning.stepping import Stepper, expected_target, watch_target
from planopt.planning.team.team_step import planning
from planopt.problems.load import require_motion, with_overrides
from planopt.problems.plausibility import JUMP_STEPS, measured_warnings
from planopt.problems.problem import Problem, problem_of_robot
from planopt.problems.settings import planner_kind
from planopt.problems.tasks import TaskProblem, task_of
from planopt.short_repr import wrapped
from planopt.world.clearance import containing_obstacle, index_obstacles
from planopt.world.workspace import Obstacle


@one_blas_thread()
def solve(
    problem: Problem,
    *,
    horizon: int | None = None,
    planner: str | None = None,
    cost_to_go: str | None = None,
    seed: int = 0,
    measurements: UserMeasurements | None = None,
    prove_s: float | None = None,
) -> Solution:
    """Return the plans of all robots from their starts; arguments as for :func:`planopt.solve`.

    The plans equal the first plans of a run with the same seed, but for smoothed routes to a goal.
    """
    seconds = None if prove_s is None else proof_seconds(prove_s)
    problem, given = with_measurements(problem, measurements)
    problem = with_overrides(problem, horizon=horizon, planner=planner, cost_to_go=cost_to_go)
    # An unreachable goal is detected before channel files are read.
    scenes = build_scenes(problem)
    solution = with_smooth_routes(
        solve_on(problem, prepare(problem, seed, given).belief, seed, scenes)
    )
    return solution if seconds is None else proven(solution, seconds)


def with_smooth_routes(solution: Solution) -> Solution:
    """Return a solution with smoothed routes to the goals, and with the costs of these routes."""
    problem, posteriors = solution.problem, solution.belief.posteriors
    if not problem.has_goal:
        return solution
    from planopt.planning.route_smoothing import RouteSmoothing

    robots = enumerate(solution.plans)
    owns = [(problem_of_robot(problem, number), plan) for number, plan in robots]
    plans = [RouteSmoothing(own, posteriors, False).smoothed(plan) for own, plan in owns]
    return replace(solution, plans=tuple(plans))


def proven(solution: Solution, prove_s: float) -> Solution:
    """Return a solution with proven bounds, and with smoothed routes if these are cheaper."""
    # Solvers are imported only if they are used.
    from planopt.planning.prove import proven_plans

    problem, belief = solution.problem, solution.belief
    plans = proven_plans(problem, belief, solution.plans, solution.aims, prove_s)
    return replace(solution, plans=plans)


def solve_on(
    problem: Problem, belief: Belief, seed: int, scenes: Sequence[Scene] | None = None
) -> Solution:
    """Return the plans of all robots from their starts for a channel belief."""
    scenes = build_scenes(problem) if scenes is None else scenes
    problem = with_drawn_starts(problem, seed)
    seeds = team_seeds(problem, seed)
    watch = watch_target(problem, seeds.target)
    robots = Stepper(problem, belief, planning(problem, scenes, seeds), watch)
    plans = robots.plan()
    return Solution(problem, seed, belief, tuple(plans), tuple(aim for (aim,) in robots.aims))


@one_blas_thread()
def simulate(
    problem: Problem,
    *,
    horizon: int | None = None,
    planner: str | None = None,
    cost_to_go: str | None = None,
    seed: int = 0,
    measurements: UserMeasurements | None = None,
    scenes: Sequence[Scene] | None = None,
    prepared: Prepared | None = None,
    on_start: Callable[[Sequence[Plan]], None] | None = None,
    on_plans: Callable[[int, Sequence[Plan]], None] | None = None,
    on_step: Callable[[int], None] | None = None,
) -> Run:
    """Return a simulated closed-loop run; arguments as for :func:`planopt.simulate`.

    Runs of one seed may share `scenes` (geometry) and `prepared` (ground truth, initial belief).
    """
    problem, measured = with_measurements(problem, measurements)
    problem = with_overrides(problem, horizon=horizon, planner=planner, cost_to_go=cost_to_go)
    problem = with_drawn_starts(problem, seed)
    prepared = prepared if prepared is not None else prepare(problem, seed, measured)
    truths = prepared.truths
    if not truths:
        raise InputError(
            "is missing: a simulation needs a ground truth",
            file=problem.file,
            key="channel.truth",
            remedy="add [channel.truth], or ChannelSetup(truth=...); solve and Planner work "
            "without",
        )
    if scenes is None:
        scenes = build_scenes(problem)
    seeds = team_seeds(problem, seed)
    target, foreseen = watch_target(problem, seeds.target), None
    kind = planner_kind(problem.planner.name)
    if kind.foresees:
        true_m = np.zeros((0, 2)) if target is None else target.true_m
        make = kind.maker()
        with calling(make, "", key="planner.name"):
            foreseen = make(problem, truths[0], true_m)
    world = true_world(problem, truths, lambda: [scene.road_map for scene in scenes or ()])
    plans = planning(problem, scenes, seeds, foreseen)
    return drive(
        problem,
        seed,
        prepared.belief,
        world,
        plans,
        target,
        seeds.target,
        on_start=on_start,
        on_plans=on_plans,
        on_step=on_step,
    )


class Planner:
    """Model predictive planner for a user's own control loop.

    Belief, track and previous plan persist between calls. Each call of :meth:`step` is one
    step of ``problem.planner.step_s`` seconds. Several planners may run in several threads;
    calling a planner while it plans in another thread raises an InputError.

    Parameters
    ----------
    problem
        Problem from :func:`planopt.load` or created in Python. For tasks other than motion
        planning the object is the controller of that task, with its own method ``step``:
        :class:`planopt.problems.NetworkController` or :class:`planopt.problems.PursuitController`.
    measurements
        Initial measurements, as for :func:`planopt.solve`. By default, they and all other random
        values equal those of :func:`planopt.simulate`, so a loop in the same ground truth repeats
        its run. With measurements, the target's initial estimate is read from its table.
    horizon, planner, cost_to_go
        Overrides of the problem's planner settings.
    budget_s
        Time limit in seconds for each robot's plan, per planning round of a team.
    seed
        Random seed.

    Raises
    ------
    InputError
        If an argument is invalid.
    NoPlanError
        If obstacles cut the goal off.

    Examples
    --------
    >>> import planopt
    >>> problem = planopt.load("open_field")
    >>> planner = planopt.Planner(problem, horizon=2)
    >>> plan = planner.step(problem.robots[0].start_m)
    >>> plan.verdict.value
    'verified'
    >>> here = plan.next_position_m
    >>> heard = planopt.Measurements([here], [-61.5])
    >>> plan = planner.step(here, heard)
    """

    @overload
    def __new__(cls, problem: TaskProblem, **settings: Any) -> Any: ...
    @overload
    def __new__(cls, problem: Problem, **settings: Any) -> Self: ...
    def __new__(cls, problem: Any, **settings: Any) -> Any:
        """Create the controller of the problem's task."""
        if isinstance(problem, TaskProblem):
            return task_of(problem).control(problem, **settings)
        return super().__new__(cls)

    @one_blas_thread()
    def __init__(  # pyright: ignore[reportInconsistentConstructor]
        self,
        problem: Problem,
        *,
        measurements: UserMeasurements | None = None,
        horizon: int | None = None,
        planner: str | None = None,
        cost_to_go: str | None = None,
        budget_s: float | None = None,
        seed: int = 0,
    ) -> None:
        problem, given = with_measurements(problem, measurements)
        require_motion(problem)
        if budget_s is not None:
            problem = replace(problem, planner=replace(problem.planner, budget_s=budget_s))
        problem = with_overrides(problem, horizon=horizon, planner=planner, cost_to_go=cost_to_go)
        problem = with_drawn_starts(problem, seed)
        scenes = build_scenes(problem)
        belief = prepare(problem, seed, given).belief
        seeds = team_seeds(problem, seed)
        watch = watch_target(problem, seeds.target) if given is None else expected_target(problem)
        self.problem = problem
        self._seed = seed
        lasting = replace(problem.workspace, obstacles=problem.workspace.lasting)
        self._index = index_obstacles(lasting)
        self._robots = Stepper(problem, belief, planning(problem, scenes, seeds), watch)
        self._is_placed = False
        self._busy = threading.Lock()

    def __repr__(self) -> str:
        """Return text with the problem and the numbers of steps and measurements."""
        steps = len(self._robots.connected)
        counts = [len(belief.posterior.measurements) for belief in self.beliefs]
        return wrapped(f"Planner({self.problem!r}, steps driven: {steps}, measurements: {counts})")

    def __getnewargs__(self) -> tuple[Problem]:
        return (self.problem,)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state to pickle: beliefs and plans, without solvers and random streams."""
        return {**vars(self), "_busy": None, "_robots": self._robots.kept()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        scenes, seeds = build_scenes(self.problem), team_seeds(self.problem, self._seed)
        self._robots = Stepper.restored(state["_robots"], planning(self.problem, scenes, seeds))
        self._busy = threading.Lock()

    @property
    def beliefs(self) -> tuple[Belief, ...]:
        """Current channel belief of each robot."""
        return tuple(self._robots.beliefs)

    def step(
        self,
        state: ArrayLike,
        measurements: UserMeasurements | None = None,
        *,
        connected: bool | None = None,
        target_m: ArrayLike | None = None,
        obstacles: Obstacle | Sequence[Obstacle] = (),
    ) -> Plan:
        """Return a plan from the current state of the only robot.

        Parameters
        ----------
        state
            ``(2,)`` position in metres, or ``(s,)`` state of a robot with dynamics in the order of
            ``state_names``.
        measurements
            Measurements since the last call, as for :func:`planopt.solve`. Measurements within
            ``channel.measure_spacing_m`` of an earlier one are ignored.
        connected
            Whether the robot is connected now. Constraints over a whole run use this value, and an
            observation of the target reaches the station only if it is true. By default, the last
            measurement decides or, without one, the prediction.
        target_m
            ``(2,)`` observed position of the target, if observed. The first call ignores it and
            uses the initial estimate of the problem.
        obstacles
            Obstacles discovered since the last call; an obstacle disappears at its ``until_s``. A
            robot inside a new obstacle leaves it first.

        Returns
        -------
        Plan
            Plan with the next position ``next_position_m`` and the next input ``next_input``.

        Raises
        ------
        InputError
            If there are several robots (use :meth:`step_all`), if the state or a measurement is
            invalid, or if another thread uses this planner. The planner is unchanged.
        NoPlanError
            If it is proven that there is no plan from this state.

        Warns
        -----
        UserWarning
            If powers are implausible, or the robot is many steps away from its plan.

        Examples
        --------
        >>> import planopt
        >>> planner = planopt.Planner(planopt.load("open_field"), horizon=5)
        >>> plan = planner.step((32.0, 30.0))
        >>> reading = {"x_m": [32.5], "y_m": [30.5], "power_dbm": [-52.0]}
        >>> planner.step(plan.next_position_m, reading).verdict.value
        'verified'
        """
        if len(self.problem.robots) > 1:
            raise InputError(
                f"step plans for one robot, but the problem has {len(self.problem.robots)}",
                remedy="call step_all, which plans for all robots",
            )
        (plan,) = self.step_all(
            [state],
            [measurements],
            connected=None if connected is None else [connected],
            target_m=None if target_m is None else [target_m],
            obstacles=obstacles,
        )
        return plan

    def step_all(
        self,
        states: Sequence[ArrayLike],
        measurements: Sequence[UserMeasurements | None] | None = None,
        *,
        connected: Sequence[bool] | Mask | None = None,
        target_m: Sequence[ArrayLike | None] | Floats | None = None,
        obstacles: Obstacle | Sequence[Obstacle] = (),
    ) -> tuple[Plan, ...]:
        """Return the plans of all robots; arguments as for :meth:`step`, one entry per robot."""
        if not self._busy.acquire(blocking=False):
            raise InputError(
                "the planner is in use by another thread",
                remedy="create one Planner for each thread, or wait until the first call returns",
            )
        try:
            return self._step_all(states, measurements, connected, target_m, obstacles)
        finally:
            self._busy.release()

    @one_blas_thread()
    def _step_all(
        self,
        states: Sequence[ArrayLike],
        measurements: Sequence[UserMeasurements | None] | None,
        connected: Sequence[bool] | Mask | None,
        target_m: Sequence[ArrayLike | None] | Floats | None,
        obstacles: Obstacle | Sequence[Obstacle],
    ) -> tuple[Plan, ...]:
        """Validate all arguments, record the outcome of the last step, and return new plans."""
        count = len(self.problem.robots)
        for key, given in (
            ("states", states),
            ("measurements", measurements),
            ("connected", connected),
            ("target_m", target_m),
        ):
            if given is not None and len(given) != count:
                raise InputError(
                    f"has {len(given)} entries, but the number of robots is {count}",
                    key=key,
                    remedy="give one entry for each robot, in the order of the problem",
                )
        remedy = "planopt.obstacles_from converts polygons, tables and grids to obstacles"
        later = parts_of("obstacles", obstacles, Obstacle, remedy)
        stated = None if connected is None else _links(connected)
        now = [self._state(number, state) for number, state in enumerate(states)]
        measured = [
            () if each is None else measurements_by_station(self.problem, each)
            for each in ([None] * count if measurements is None else measurements)
        ]
        for words in self._implausible(now, measured):
            warnings.warn(words, UserWarning, stacklevel=4)
        places = [None] * count if target_m is None else target_m
        seen = np.array([self._seen(place) for place in places])
        if self._is_placed:
            links = (
                [self._was_connected(*both) for both in enumerate(measured)]
                if stated is None
                else stated
            )
            self._robots.observe(now, measured, links, seen, observed=stated is not None)
        else:
            self._robots.place(now, measured)
            self._is_placed = True
        if later:
            self._robots.add_obstacles(later)
        return tuple(self._robots.plan())

    def _state(self, number: int, given: ArrayLike) -> Floats:
        """Return a robot's state from user input, after validation."""
        robot = self.problem.robots[number]
        key = f"states[{number}]" if len(self.problem.robots) > 1 else "state"
        names = robot.dynamics.state_names
        state = finite_array(key, given, (len(names),), f"give {', '.join(names)}")
        # Drift may carry a robot slightly out of bounds; a large offset means another frame.
        nearest = np.clip(state[:2], *np.reshape(self.problem.workspace.bounds_m, (2, 2)))
        reach = self._robots.owns[number].step_length_m if robot.moves_freely else 0.0
        if float(np.linalg.norm(state[:2] - nearest)) > reach:
            raise InputError(
                f"is {state.tolist()}, outside world.bounds_m = "
                f"{list(self.problem.workspace.bounds_m)}",
                key=key,
                remedy="give metres in the coordinate frame of the problem, or enlarge "
                "world.bounds_m",
            )
        around = containing_obstacle(self._index, state[:2])
        if around is not None:
            raise InputError(
                f"is {state.tolist()}, inside the obstacle {around.name}",
                key=key,
                remedy="correct the position or the map",
            )
        return state

    def _implausible(
        self, states: Sequence[Floats], measured: Sequence[Sequence[Measurements]]
    ) -> Iterator[str]:
        """Yield warnings about implausible powers and robots far from their plans."""
        for taken in (each for stations in measured for each in stations):
            yield from measured_warnings(taken)
        for number, (state, plans) in enumerate(zip(states, self._robots.plans, strict=True)):
            if not plans or not self._is_placed:
                continue
            off_m = float(np.linalg.norm(state[:2] - plans[-1].next_position_m))
            step_m = self._robots.owns[number].step_length_m
            if off_m > JUMP_STEPS * step_m:
                yield (
                    f"robot {number} is {off_m:.4g} m from where its plan led, and drives "
                    f"{step_m:.4g} m in a step (check frame and unit of its position)"
                )

    def _seen(self, place: ArrayLike | None) -> Floats:
        """Return the observed position of the target; NaN without an observation."""
        if place is None:
            return np.full(2, np.nan)
        if not self.problem.targets:
            raise InputError(
                "was given, but the problem has no target", key="target_m", remedy="leave it out"
            )
        return finite_array("target_m", place, (2,), "give x_m, y_m")

    def _was_connected(self, number: int, measured: Sequence[Measurements]) -> bool:
        """Return whether a robot is connected, according to measurements or its previous plan."""
        stations = self.problem.stations
        received = [
            bool(taken.power_dbm[-1] >= station.threshold_dbm and not taken.censored[-1])
            for station, taken in zip(stations, measured, strict=False)
            if len(taken)
        ]
        if received:
            return any(received)
        plans = self._robots.plans[number]
        return bool(plans and plans[-1].connectivity[1] >= 0.5)


def _links(given: Sequence[bool] | Mask) -> list[bool]:
    """Return the robots' connection states; raise an InputError if one is not a boolean."""
    values: Sequence[object] = list(given)
    for number, value in enumerate(values):
        if not isinstance(value, bool | np.bool_):
            raise InputError(
                f"is {value!r}, should be a Boolean",
                key=f"connected[{number}]",
                remedy="give True or False",
            )
    return [bool(value) for value in values]
