"""Results of the former file format, saved by that version, are read and judged for one version."""

import json
import shutil
from pathlib import Path

import pytest

from planopt.errors import InputError
from planopt.planning.check.check import check
from planopt.planning.files.read_saved import read_saved
from planopt.planning.plan import Verdict

FORMER = Path(__file__).parent / "former"
FOLDERS = ("reach_plan", "reach_run", "team_plan", "team_run")


@pytest.mark.parametrize("name", FOLDERS)
def test_a_former_result_is_judged_in_full(name: str) -> None:
    """Keys that it has are computed again, but for costs; a remark says that its time is over."""
    result = check(FORMER / name)
    assert result.verdict is Verdict.VERIFIED, result.reasons
    assert any("form of an earlier version" in remark for remark in result.remarks)
    assert any("costs" in remark for remark in result.remarks) == (name == "reach_run")
    assert read_saved(FORMER / name).former


@pytest.mark.parametrize("name", FOLDERS)
def test_a_false_former_result_is_rejected(name: str, tmp_path: Path) -> None:
    """Bringing a file into today's form hides nothing that was edited in it."""
    folder = tmp_path / name
    shutil.copytree(FORMER / name, folder)
    file = next(folder.glob("*.json"))
    text = file.read_text()
    edits = ('"problem": "', '"seed": ', '"x_m": [', '"rung": "', '"posterior": "', '"path_m": ')
    tried = 0
    for words in edits:
        if words in text:
            more = "x" if words.endswith('"') else "9"
            file.write_text(text.replace(words, words + more, 1))
            assert check(folder).verdict is Verdict.VIOLATED, words
            tried += 1
    assert tried >= 4


@pytest.mark.parametrize("name", ["reach_plan", "reach_run", "team_plan"])
def test_a_key_of_the_former_form_that_is_gone_is_missed(name: str, tmp_path: Path) -> None:
    """What is left is read as it stands, and the reader names what is not there."""
    folder = tmp_path / name
    shutil.copytree(FORMER / name, folder)
    file = next(folder.glob("*.json"))
    data = json.loads(file.read_text())
    for key in ("holes", "robots"):
        file.write_text(json.dumps({name: part for name, part in data.items() if name != key}))
        with pytest.raises(InputError):
            read_saved(folder)
