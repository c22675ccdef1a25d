"""Rules of connectivity of one's own: a function of the probabilities of connection."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.parts import calling, class_name, returned
from planopt.planning.certificate import RuleResult
from planopt.planning.history import History
from planopt.planning.proof.rules.rule import ROUNDING, BySlack, PathCase, Rule
from planopt.problems.constraints import register_rule

KEY = "constraints.connectivity"


class OwnRule(Rule):
    """Base class of a rule of one's own: a frozen dataclass with a ``kind`` and what it counts.

    The fields of a subclass are the keys of ``constraints.settings``, all numbers. The verifier
    judges by :meth:`achieved`; planners seek plans by it and its slopes. It must not fall where a
    probability rises.

    Attributes
    ----------
    kind
        Value of the key ``constraints.connectivity``.
    unit
        Of what is achieved; a ``"probability"``, the default, is from 0 to 1.
    asks_p_min
        Whether p_min is what is asked; a rule that asks for something else returns that by
        :meth:`asked`.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> from typing import ClassVar
    >>> import numpy as np
    >>> from planopt.extend import OwnRule
    >>> @dataclass(frozen=True)
    ... class Soon(OwnRule):
    ...     "Connected at least once within the first steps, were steps independent."
    ...
    ...     kind: ClassVar[str] = "soon"
    ...     steps: float = 5
    ...
    ...     def achieved(self, probability, history):
    ...         return 1.0 - np.prod(1.0 - probability[..., : int(self.steps)], axis=-1)
    >>> Soon(2).achieved(np.array([0.5, 0.5, 0.9]), None)
    np.float64(0.75)
    """

    kind: ClassVar[str]

    def __init_subclass__(cls, **keywords: Any) -> None:
        """Let problems name the rule, in this process and in workers of its studies."""
        super().__init_subclass__(**keywords)
        if not cls.asks_p_min and cls.asked is OwnRule.asked:
            raise InputError(
                f"{class_name(cls)} has asks_p_min = False and no method asked",
                key="asked",
                remedy="define asked(self, p_min), or leave asks_p_min out",
            )
        if "kind" in cls.__dict__:
            register_rule(cls)

    @abstractmethod
    def achieved(
        self, probability: NDArray[np.float64], history: History
    ) -> float | NDArray[np.float64]:
        """Return what plans achieve, which is to be large.

        Parameters
        ----------
        probability
            ``(..., N)`` of connection after each step of a plan, of one or of many plans.
        history
            What has happened before.
        """

    def asked(self, p_min: float) -> float:
        """Return what must be achieved at least."""
        return p_min

    def valued(self, probability: NDArray[np.float64], history: History) -> NDArray[np.float64]:
        """Return :meth:`achieved` as numbers ``(...)``.

        Raises
        ------
        InputError
            It has another shape, is not finite, or is a probability below 0 or above 1.
        """
        words = f"{self._number} for each plan of probabilities (..., N)"
        with calling(self, "achieved", key=KEY, remedy=f"return {words}"):
            found = self.achieved(probability, history)
        shape = probability.shape[:-1]
        return self._within(
            "achieved", returned(self, "achieved", found, shape, words=words, key=KEY), words
        )

    def required(self, p_min: float, history: History, count: int) -> float:
        """Return :meth:`asked` as a number.

        Raises
        ------
        InputError
            It is none, or a probability below 0 or above 1.
        """
        words = self._number
        with calling(self, "asked", key=KEY, remedy=f"return {words}"):
            found = self.asked(p_min)
        number = returned(self, "asked", found, (), words=words, key=KEY)
        return float(self._within("asked", number, words))

    @property
    def _is_probability(self) -> bool:
        return self.unit == OwnRule.unit

    @property
    def _number(self) -> str:
        """Return what a value must be, for messages."""
        return "one number from 0 to 1" if self._is_probability else "one finite number"

    def _within(self, method: str, values: NDArray[np.float64], words: str) -> NDArray[np.float64]:
        """Return the values of a method, which are from 0 to 1 where they are probabilities."""
        if not self._is_probability:
            return values
        inside = np.clip(values, 0.0, 1.0)
        if (np.abs(values - inside) > ROUNDING).any():
            worst = values.flat[int(np.argmax(np.abs(values - inside)))]
            raise InputError(
                f"{class_name(self)}.{method} returned {worst:.6g}, which is no {self.unit}",
                key=KEY,
                remedy=f'return {words}, or set the attribute unit, e.g. unit = "steps"',
            )
        return inside

    def by_slack(self, case: PathCase) -> BySlack:
        """Return the value of a path, having checked that it does not fall."""
        self.slopes(case.probability(0.0), case.history)
        return super().by_slack(case)

    def missed_words(self, result: RuleResult) -> tuple[str, str]:
        """Name the rule."""
        key = self.bound_key if self.asks_p_min else "the rule"
        return f"what constraints.connectivity {self.kind!r} counts", key
