"""The README and the generated page of keys say what the code does; their code: test_docs_code."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from planopt.problems.schema import json_schema

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_first_plan_is_short() -> None:
    """The README's only Python, a first plan, takes at most 15 lines."""
    (code,) = re.findall(r"^```python\n(.*?)^```", README, flags=re.MULTILINE | re.DOTALL)
    assert len(code.strip().splitlines()) <= 15


@pytest.mark.parametrize(
    "file", [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))], ids=lambda path: path.name
)
def test_links(file: Path) -> None:
    """Files that a page links to are there."""
    text = file.read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)#]+)\)", text) + re.findall(r"\{image\} (\S+)", text)
    for target in targets:
        assert target.startswith("https://") or (file.parent / target).exists(), target


def test_exit_codes_and_verdicts() -> None:
    """The README explains every verdict there is."""
    from planopt import Verdict

    assert all(f"| `{verdict.value}` |" in README for verdict in Verdict)


def keys_of(node: Any) -> Iterator[str]:
    """Every key of every table of a schema."""
    for table in node["$defs"].values():
        yield from table["properties"]


def test_page_of_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    """The generated page has every key of the schema, each with its description."""
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    from problem_keys import problem_keys  # pyright: ignore[reportMissingImports]

    page = problem_keys()
    sys.modules.pop("problem_keys")
    tables = {
        "truth",
        "measurements",
        "fit",
        "columns",
        "obstacles",
        "multipath",
        "terms",
        "moving",
    }
    for key in set(keys_of(json_schema())) - tables:
        assert re.search(rf"^\| `{key}` \| .+ \| .+ \| .+\.? \|$", page, flags=re.MULTILINE), key
    for heading in ("[problem]", "[[world.obstacles]]", "[channel.truth]", "[[robots]]"):
        assert f"## `{heading}`" in page


def test_nothing_refers_to_what_a_reader_cannot_look_up() -> None:
    """No papers by nickname and no numbered equations of elsewhere in the schema's words."""
    words = json.dumps(json_schema())
    assert not re.findall(r"(?i)the seed's|theory|lemma \d|\bdesign\b|\(\d\)", words)
