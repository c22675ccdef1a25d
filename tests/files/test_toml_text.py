"""TOML text is read back as it was."""

import tomllib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planopt.files.writing import toml_text

KEYS = st.text(min_size=1, max_size=8)
SCALARS = st.one_of(
    st.booleans(),
    st.integers(-(2**62), 2**62),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text(st.characters(exclude_categories=["Cs"]), max_size=20),
)
TABLES = st.recursive(
    st.dictionaries(KEYS, st.one_of(SCALARS, st.lists(SCALARS, max_size=3)), max_size=4),
    lambda inner: st.dictionaries(
        KEYS, st.one_of(SCALARS, inner, st.lists(inner, min_size=1, max_size=3)), max_size=4
    ),
    max_leaves=12,
)


@settings(max_examples=300, deadline=None)
@given(TABLES)
def test_there_and_back(tables: dict[str, object]) -> None:
    """Values, tables and arrays of tables, with any text in keys and values."""
    assert tomllib.loads(toml_text(tables)) == tables


def test_comments_and_keys_without_a_value() -> None:
    """A comment follows its value or precedes its table; None is left out."""
    tables = {"a": {"b": 1.5, "c": None, "d": {"e": [1, 2]}}}
    text = toml_text(tables, {"a.b": "a half more", "a.d": "two numbers"})
    assert "b = 1.5  # a half more" in text and "# two numbers\n[a.d]" in text
    assert tomllib.loads(text) == {"a": {"b": 1.5, "d": {"e": [1, 2]}}}


@pytest.mark.parametrize("value", [float("nan"), float("inf"), object()])
def test_values_that_toml_lacks(value: object) -> None:
    with pytest.raises((ValueError, TypeError)):
        toml_text({"a": value})
