"""The tables ``[[objective.terms]]``: one for each kind of term that is registered."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Annotated, Any, Union

from pydantic import (
    BaseModel,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    PydanticUserError,
    TypeAdapter,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from planopt.errors import InputError
from planopt.objectives.terms.term import Term, registered_terms
from planopt.parts import class_name, is_own
from planopt.problems.tables import made_of, table_of


class AnyTerm:
    """Marks a place of the schema where a table of any registered kind may stand."""

    def tables(self) -> Sequence[type[BaseModel]]:
        """Return the tables of all kinds."""
        return _tables_of(registered_terms())

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Read a table of the kinds that are registered then."""
        return core_schema.no_info_plain_validator_function(read_term)

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Describe the tables of all kinds."""
        return handler(_adapter_of(registered_terms()).core_schema)


ANY_TERM = AnyTerm()


def read_term(value: object) -> Term:
    """Return the term that a table describes."""
    table = _adapter_of(registered_terms()).validate_python(value)
    kinds = {term.kind: term for term in registered_terms()}
    chosen = kinds[table.kind]
    term = made_of(chosen, table)
    fault = chosen.table_fault(frozenset(table.model_fields_set), term)
    if fault is not None:
        raise PydanticCustomError("one_of", "{words}", {"words": fault})
    return term


@lru_cache(maxsize=4)
def _adapter_of(terms: tuple[type[Term], ...]) -> TypeAdapter[Any]:
    choice: Any = Union[_tables_of(terms)]  # pyright: ignore  # noqa: UP007
    tagged: Any = Annotated[choice, Field(discriminator="kind")]  # pyright: ignore
    return TypeAdapter[Any](tagged)


@lru_cache(maxsize=4)
def _tables_of(terms: tuple[type[Term], ...]) -> tuple[type[BaseModel], ...]:
    return tuple(_table_of(term) for term in terms)


def _table_of(term: type[Term]) -> type[BaseModel]:
    try:
        return table_of(term)
    except (PydanticUserError, NameError, TypeError) as error:
        if not is_own(term):
            raise
        raise InputError(
            f"the fields of the term {class_name(term)} cannot be keys of a table: {error}",
            key="objective.terms",
            remedy="annotate each with a number, text, or a tuple of these",
        ) from error
