"""The tables of the page on the channel have the options and methods there are."""

import re
from pathlib import Path
from typing import get_args

import pytest

from planopt.channel.estimation.channel_fit import FitMethod
from planopt.cli import main

PAGE = (Path(__file__).parents[1] / "docs" / "channel.md").read_text(encoding="utf-8")


def test_options_and_methods(capsys: pytest.CaptureFixture[str]) -> None:
    """Every option in the tables exists, and every option of a log and every method is there."""
    assert main(["fit", "--help"]) == 0
    shown = set(re.findall(r"--[a-z-]+", capsys.readouterr().out))
    named = set(re.findall(r"--[a-z][a-z-]+", PAGE)) - {"--picture"}
    assert named <= shown
    assert shown - named <= {"--help", "--out", "--json"}
    for method in get_args(FitMethod):
        assert f"| `{method}` |" in PAGE
