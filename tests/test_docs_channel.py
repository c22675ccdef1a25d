"""The page on the channel: its code runs, its tables have the options and methods there are."""

from __future__ import annotations

import re
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from planopt.channel.estimation.fit_method import FitMethod
from planopt.cli import main

PAGE = (Path(__file__).parents[1] / "docs" / "channel.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    """Code blocks of the page in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL)


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A log such as the page takes for granted, in the working folder."""
    monkeypatch.chdir(tmp_path)
    generator = np.random.default_rng(4)
    places = generator.uniform(-200.0, 200.0, (60, 2))
    distance = np.hypot(places[:, 0] - 40.0, places[:, 1])
    power = -30.0 - 35.0 * np.log10(distance) + generator.normal(0.0, 6.0, 60)
    rows = [
        f"{x:.2f},{y:.2f},{max(p, -112.0):.2f},{int(p < -112.0)},{i // 20},{i}"
        for i, ((x, y), p) in enumerate(zip(places, power, strict=True))
    ]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["x_m,y_m,power_dbm,at_floor,day,t_s", *rows]))
    return path


def test_python(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The blocks, one after the other, are one script that runs."""
    found: dict[str, object] = {}
    exec(compile("\n".join(blocks("python")), "docs/channel.md", "exec"), found)
    printed = capsys.readouterr().out
    assert "marginal GroupedRatio" in printed and "m until connected" in printed
    assert {"prediction", "maps", "wider", "together", "outage", "data"} <= set(found)


def test_commands(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The commands run as they stand there."""
    commands = "".join(blocks("sh")).replace("\\\n", "").splitlines()
    assert len(commands) == 4
    for command in commands:
        program, *arguments = command.split()
        assert program == "planopt"
        assert main(arguments) == 0
    capsys.readouterr()
    assert (log.parent / "fit" / "fit.png").exists()
    assert (log.parent / "map.nc").exists() and (log.parent / "map.png").exists()


def test_options_and_methods(capsys: pytest.CaptureFixture[str]) -> None:
    """Every option in the tables exists, and every option of a log and every method is there."""
    assert main(["fit", "--help"]) == 0
    shown = set(re.findall(r"--[a-z-]+", capsys.readouterr().out))
    named = set(re.findall(r"--[a-z][a-z-]+", PAGE)) - {"--picture"}
    assert named <= shown
    assert shown - named <= {"--help", "--out", "--json"}
    for method in get_args(FitMethod):
        assert f"| `{method}` |" in PAGE
