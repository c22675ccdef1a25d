"""The README and the generated page of keys say what the code does."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from planopt.cli import main
from planopt.problems.schema import json_schema

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
NUMBER = re.compile(r"\d+\.\d+|\d+")


def blocks(language: str) -> list[str]:
    """Code blocks of the README in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", README, flags=re.MULTILINE | re.DOTALL)


def without_numbers(text: str) -> str:
    """Text whose numbers may differ: by processor and by load."""
    return NUMBER.sub("#", text).strip()


def test_first_plan(capsys: pytest.CaptureFixture[str]) -> None:
    """The first plan takes at most 15 lines, runs, and is verified."""
    (code,) = blocks("python")
    assert len(code.strip().splitlines()) <= 15
    exec(compile(code, "README.md", "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("verified")
    assert len(lines) == 3 + 11


def test_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every command of the README prints what the README shows, up to its numbers."""
    monkeypatch.chdir(tmp_path)
    (session,) = blocks("console")
    shown = re.findall(r"^\$ planopt (.*)\n((?:[^$].*\n)*)", session, flags=re.MULTILINE)
    assert len(shown) == session.count("$ ")
    for command, output in shown:
        assert main(command.split()) == 0
        assert without_numbers(capsys.readouterr().out) == without_numbers(output)


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
