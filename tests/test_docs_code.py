"""The code of every page runs: Python and commands in order, tables as part of a problem file.

A block that is not run has a comment on the line before it that says why:
``<!-- not run: takes an hour -->``. Its commands must still be there, with their options.
"""

import os
import re
import shlex
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from planopt import InputError
from planopt.cli import main
from planopt.problems import list_problems
from planopt.problems.library import library_folder
from planopt.problems.problem import problem_from_tables

ROOT = Path(__file__).parents[1]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
BLOCK = re.compile(
    r"(?:^<!-- not run: (?P<reason>.+?) -->\n)?^```(?P<language>\S*)\n(?P<text>.*?)^```$",
    flags=re.MULTILINE | re.DOTALL,
)
NUMBER = re.compile(r"\d+(\.\d+)?(e[+-]\d+)?")
NOT_CODE = ("", "text")
"""Languages of what a page shows and nobody runs; ``{...}`` is Sphinx's."""


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    page: Path
    line: int
    language: str
    text: str
    reason: str | None

    @property
    def commands(self) -> list[str]:
        """Its command lines, continued ones joined, comments left out."""
        lines = re.sub(r"\\\n\s*", "", self.text).splitlines()
        if self.language == "console":
            lines = [line[2:] for line in lines if line.startswith("$ ")]
        return [line for line in lines if line and not line.startswith("#")]


def blocks_of(page: Path) -> list[Block]:
    text = page.read_text(encoding="utf-8")
    return [
        Block(
            page,
            text.count("\n", 0, found.start("text")) + 1,
            found["language"],
            found["text"],
            found["reason"],
        )
        for found in BLOCK.finditer(text)
        if found["language"] not in NOT_CODE and not found["language"].startswith("{")
    ]


BLOCKS = [block for page in PAGES for block in blocks_of(page)]
WITH_CODE = sorted({block.page for block in BLOCKS if block.language != "toml"})
TABLES = [block for block in BLOCKS if block.language == "toml"]
NOT_RUN = [block for block in BLOCKS if block.reason is not None]


def name_of(thing: Path | Block) -> str:
    return thing.name if isinstance(thing, Path) else f"{thing.page.name}:{thing.line}"


def without_numbers(text: str) -> str:
    """Text whose numbers may differ: by processor and by load."""
    return NUMBER.sub("#", text).strip()


def test_every_language_is_known() -> None:
    """Every block has a language that the tests know."""
    assert {block.language for block in BLOCKS} == {"python", "console", "sh", "toml"}


@pytest.mark.usefixtures("own_parts")
@pytest.mark.parametrize("page", WITH_CODE, ids=name_of)
def test_page_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The blocks of a page, one after the other, in a folder as a checkout is."""
    monkeypatch.chdir(tmp_path)
    for name in ("docs", "problems"):
        (tmp_path / name).symlink_to(ROOT / name)
    names: dict[str, Any] = {"__name__": page.name}
    for block in blocks_of(page):
        if block.reason is not None:
            continue
        if block.language == "python":
            # Empty lines before it, so that a traceback has the line of the page.
            code = "\n" * (block.line - 1) + block.text
            exec(compile(code, str(page), "exec", dont_inherit=True), names)
        elif block.language == "sh":
            shell(block.text, block)
        elif block.language == "console":
            for command, shown in sessions(block):
                printed = without_numbers(shell(command, block))
                assert printed == without_numbers(shown), (name_of(block), command)


def sessions(block: Block) -> list[tuple[str, str]]:
    """Commands of a console, each with what it is said to print."""
    found = re.findall(r"^\$ (.*)\n((?:(?!\$ ).*\n)*)", block.text, flags=re.MULTILINE)
    assert len(found) == len(block.commands), name_of(block)
    return found


def shell(text: str, block: Block) -> str:
    """Run text in a shell that finds this environment's programs; what it prints."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-e", "-c", text], capture_output=True, text=True, env={**os.environ, "PATH": path}
    )
    assert done.returncode == 0, (name_of(block), done.stdout, done.stderr)
    return done.stdout


@pytest.mark.parametrize("block", NOT_RUN, ids=name_of)
def test_what_is_not_run_could_be(block: Block, capsys: pytest.CaptureFixture[str]) -> None:
    """Options, scripts and targets that a page names are there; Python compiles."""
    if block.language == "python":
        compile(block.text, name_of(block), "exec")
        return
    for command in block.commands:
        program, *arguments = shlex.split(command, comments=True)
        if program == "planopt":
            # Unknown options and missing values are found before help is printed.
            assert main([*arguments, "--help"]) == 0, command
        elif program == "python":
            scripts = [argument for argument in arguments if argument.endswith(".py")]
            assert scripts and all((ROOT / script).exists() for script in scripts), command
        else:
            assert program == "make", command
            makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
            assert all(re.search(rf"^{target}:", makefile, re.MULTILINE) for target in arguments)
    capsys.readouterr()


@pytest.mark.parametrize("block", TABLES, ids=name_of)
def test_tables_are_part_of_a_problem(block: Block) -> None:
    """Put into a problem of the library, they make a valid one."""
    tables = tomllib.loads(block.text)
    faults: list[str] = []
    for entry in list_problems():
        whole = tomllib.loads(entry.path.read_text(encoding="utf-8"))
        try:
            problem_from_tables(merged(whole, tables), folder=library_folder(), file=None)
            return
        except InputError as error:
            faults.append(f"{entry.name}: {error}")
    pytest.fail("\n".join(faults))


def merged(whole: dict[str, Any], part: dict[str, Any]) -> dict[str, Any]:
    """The tables of `whole` with those of `part` in their place; arrays are replaced."""
    found = dict(whole)
    for key, value in part.items():
        both = isinstance(value, dict) and isinstance(found.get(key), dict)
        found[key] = merged(found[key], value) if both else value
    return found


def test_readers_of_python_see_no_type_errors(tmp_path: Path) -> None:
    """Pyright has nothing to say of the Python on the pages: what they show is typed."""
    pytest.importorskip("pyright")
    for page in WITH_CODE:
        code = [(block.line, block.text) for block in blocks_of(page) if block.language == "python"]
        lines: list[str] = []
        for line, text in code:
            lines += [""] * (line - 1 - len(lines)) + text.splitlines()
        (tmp_path / f"{page.stem}.py").write_text("\n".join(lines) + "\n")
    command = [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, str(tmp_path)]
    told = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert told.returncode == 0, told.stdout
