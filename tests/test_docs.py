"""The README and the generated page of keys say what the code does; their code: test_docs_code."""

import ast
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import planopt
from planopt.problems.schema import json_schema

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_readme() -> None:
    """The animation loads quickly, every verdict is explained, and its Python is short."""
    codes = re.findall(r"^```python\n(.*?)^```", README, flags=re.MULTILINE | re.DOTALL)
    most = (15, 10)
    assert 1 <= len(codes) <= len(most)
    for code, lines in zip(codes, most, strict=False):
        assert len(code.strip().splitlines()) <= lines
    from PIL import Image

    file = ROOT / "docs" / "pictures" / "munich_courier.gif"
    assert f"({file.relative_to(ROOT)})" in README
    assert file.stat().st_size < 2_000_000
    with Image.open(file) as animation:
        assert getattr(animation, "n_frames", 1) > 20
    from planopt import Verdict

    assert all(f"| `{verdict.value}` |" in README for verdict in Verdict)


PAGES = [
    *(ROOT / name for name in ("README.md", "CHANGELOG.md")),
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs" / "theory").glob("*.md")),
]


@pytest.mark.parametrize("file", PAGES, ids=lambda path: path.name)
def test_modules_that_a_page_names_are_there(file: Path) -> None:
    """By name, or by the end of the path: modules that were moved or merged are named anew."""
    modules = [path.as_posix() for path in ROOT.glob("*/**/*.py") if ".venv" not in path.parts]
    for name in re.findall(r"`([a-z_0-9/]+\.py)`", file.read_text(encoding="utf-8")):
        assert any(module.endswith(f"/{name}") for module in modules), name


@pytest.mark.parametrize("file", PAGES, ids=lambda path: path.name)
def test_links(file: Path) -> None:
    """Files that a page links to are there."""
    text = file.read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)#]+)\)", text) + re.findall(r"\{image\} (\S+)", text)
    for target in targets:
        assert target.startswith("https://") or (file.parent / target).exists(), target


def keys_of(node: Any) -> Iterator[str]:
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
        "given",
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


def test_words_of_schema_and_docstrings() -> None:
    """No nicknames of papers in the schema, and no docstring that opens without a subject."""
    words = json.dumps(json_schema())
    assert not re.findall(r"(?i)the seed's|theory|lemma \d|\bdesign\b|\(\d\)", words)
    opening = re.compile(r"(What|Of|Where|Whether|Why|By how|Those|Plan alone)\b")
    riddles = [
        f"{path}: {words.splitlines()[0]}"
        for path in sorted(Path(planopt.__file__).parent.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Module)
        and (words := ast.get_docstring(node)) is not None
        and opening.match(words)
    ]
    assert not riddles
