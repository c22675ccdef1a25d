"""The tables ``[[objective.terms]]``: one for each kind of term that is registered."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from dataclasses import MISSING, fields
from functools import lru_cache
from typing import Annotated, Any, Literal, Union, cast, get_type_hints

from pydantic import BaseModel, Field, GetCoreSchemaHandler, GetJsonSchemaHandler, TypeAdapter
from pydantic import create_model as model_of
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from planopt.objectives.terms.term import Term, registered_terms
from planopt.problems.tables import Table


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
    """Return the term that a table describes.

    Raises
    ------
    ValidationError
        Its location begins with the kind, where that is known.
    """
    table = _adapter_of(registered_terms()).validate_python(value)
    kinds = {term.kind: term for term in registered_terms()}
    chosen = kinds[table.kind]
    term = chosen(**{each.name: getattr(table, each.name) for each in fields(chosen)})
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


@lru_cache(maxsize=64)
def _table_of(term: type[Term]) -> type[BaseModel]:
    """Return the table whose keys are the fields of a term."""
    hints = get_type_hints(term, include_extras=True)
    keys: dict[str, Any] = {
        "kind": (Literal[term.kind], Field(description=term.summary)),  # pyright: ignore
    }
    for each in fields(term):
        hint = hints[each.name]
        keys[each.name] = hint if each.default is MISSING else (hint, each.default)
    words = inspect.cleandoc(term.__doc__ or term.summary).partition("\n")[0]
    name = f"{term.__name__.removesuffix('Term')}Table"
    made = model_of(name, __base__=Table, __doc__=words, __module__=term.__module__, **keys)
    return cast("type[BaseModel]", made)
