"""Commands and problem files of the tests of tasks."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from planopt.cli import main


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, dict[str, Any]]]:
    """Run a command; return its exit code and its JSON."""

    def command(*arguments: object) -> tuple[int, dict[str, Any]]:
        code = main([*map(str, arguments), "--json"])
        return code, json.loads(capsys.readouterr().out)

    return command


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Write a problem file of a text, with parts replaced and others added."""

    def file_of(text: str, *changes: tuple[str, str], more: str = "") -> Path:
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        file = tmp_path / "problem.toml"
        file.write_text(text + more)
        return file

    return file_of
