"""Theory and its references: numbered equations, functions that exist, and nothing outside."""

import ast
import re
import subprocess
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CHAPTERS = (
    "channel",
    "estimation",
    "connectivity",
    "objectives",
    "rules",
    "planning",
    "coverage",
    "pursuit",
    "bounds",
)
PAGES = [ROOT / "docs" / "theory" / f"{name}.md" for name in CHAPTERS]
TAG = re.compile(r"\\tag\{(\d+)\.(\d+)\}")
CODE = re.compile(r"^\*\*Code:\*\*(.*?)(?=\n\n|\Z)", flags=re.MULTILINE | re.DOTALL)
MENTION = re.compile(r"\bequations? (\d+\.\d+)(?:(?:,| and| to) (\d+\.\d+))*")
CITED = re.compile(r"(?<!\[)\[((?:GM|CZ|CK|CP|KG|NW|OW|RW)\d\d|KAS|[A-Z][a-z]{2}\d\d)\](?!\()")
OUTSIDE = re.compile(
    r"(?i)\bthe seed's\b|\(seed, (?:section|Lemma|Fig|eq|footnote|Algorithm|\(|proof|after)"
    r"|\btheory \d|\bdesign\.md|\bexperiments? [A-Z]\)|theory, errata"
)
BARE = re.compile(r"(?<![\w.])\((\d+\.\d+)\)")


@cache
def equations() -> frozenset[str]:
    return frozenset(
        ".".join(found.groups())
        for page in PAGES
        for found in TAG.finditer(page.read_text("utf-8"))
    )


@cache
def defined_names() -> frozenset[str]:
    """Every function, method, class and constant that planopt defines."""
    names: set[str] = set()
    for file in (ROOT / "planopt").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                names.add(node.name)
            elif isinstance(node, ast.Assign):
                names |= {target.id for target in node.targets if isinstance(target, ast.Name)}
    return frozenset(names)


@cache
def tracked_texts() -> tuple[tuple[str, str], ...]:
    """Name and text of the project's own sources and pages."""
    listed = subprocess.run(
        ["git", "ls-files", "*.py", "*.md", "*.toml", "*.json", "*.rst", "Makefile"],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=True,
    ).stdout.splitlines()
    return tuple(
        (name, (ROOT / name).read_text("utf-8")) for name in listed if (ROOT / name).exists()
    )


@pytest.mark.parametrize("chapter", range(1, len(PAGES) + 1))
def test_equations_are_numbered_in_order(chapter: int) -> None:
    """Every displayed equation of a page has a number, and the numbers count up from 1."""
    text = PAGES[chapter - 1].read_text("utf-8")
    assert text.startswith(f"# {chapter}. ")
    displayed = re.findall(r"^\$\$(.*?)\$\$$", text, flags=re.MULTILINE | re.DOTALL)
    tags = [TAG.findall(equation) for equation in displayed]
    expected = [[(str(chapter), str(number + 1))] for number in range(len(displayed))]
    assert displayed and tags == expected


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_named_functions_exist(page: Path) -> None:
    """What a page names as the code of an equation is defined in planopt."""
    named = [
        name for line in CODE.findall(page.read_text("utf-8")) for name in line.split("`")[1::2]
    ]
    assert named
    assert [name for name in named if name not in defined_names()] == []


def test_chapters_and_mentioned_equations_exist() -> None:
    """The overview links to every page; "equation 3.4" in any file is of an equation there is."""
    overview = (ROOT / "docs" / "theory.md").read_text("utf-8")
    assert {page.name for page in (ROOT / "docs" / "theory").glob("*.md")} == {
        page.name for page in PAGES
    }
    assert all(f"(theory/{name}.md)" in overview for name in CHAPTERS)
    wrong = [
        (name, found.group())
        for name, text in tracked_texts()
        for found in MENTION.finditer(re.sub(r"\s+(?:# )?", " ", text))
        if not set(re.findall(r"\d+\.\d+", found.group())) <= equations()
    ]
    assert wrong == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_numbers_in_brackets_exist(page: Path) -> None:
    """The pages of theory refer to equations as (3.4), and only to such that exist."""
    text = re.sub(r"\$\$.*?\$\$", "", page.read_text("utf-8"), flags=re.DOTALL)
    assert set(BARE.findall(text)) <= equations()


def test_citations_are_in_the_references() -> None:
    """Every citation of pages and code is an entry, and pages cite every entry."""
    references = (ROOT / "docs" / "references.md").read_text("utf-8")
    entries = set(re.findall(r"^\*\*\[(\w+)\]\*\*", references, flags=re.MULTILINE))
    cited = {
        key
        for name, text in tracked_texts()
        if name.endswith(".md") or name.startswith("planopt/")
        for key in re.findall(r"\[\[(\w+)\]\]\((?:\.\./)?references\.md\)", text)
    }
    assert cited == entries
    references = (ROOT / "docs" / "references.md").read_text("utf-8")
    wrong = [
        (name, found.group())
        for name, text in tracked_texts()
        if not name.endswith(".md") and name != "tests/test_theory.py"
        for found in CITED.finditer(text)
        if f"**[{found.group(1)}]**" not in references
    ]
    assert wrong == []


def test_no_reference_leads_outside() -> None:
    """No text refers to a paper by nickname, or to notes that are not in the repository."""
    wrong = [
        (name, found.group())
        for name, text in tracked_texts()
        if name not in ("tests/test_theory.py", "tests/test_docs.py")
        for found in OUTSIDE.finditer(text)
    ]
    assert wrong == []
