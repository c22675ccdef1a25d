"""Run the tests of what has changed, in a given time: ``make quick``.

With ``--quick SECONDS`` only the tests are collected that stand where the files that changed since
the last commit but one do (``planopt/channel/logs/power_log.py``: ``tests/channel``), and the
golden cases. The first test of every file runs, then the second of every file, and so on until the
time is over. No list of tests has to be kept up to date.
"""

import subprocess
import time
from collections import Counter
from pathlib import Path

import pytest
import refusals

TESTS = Path(__file__).parent
ALWAYS = ("golden", "test_public.py", "test_imports.py")
CHANGED = pytest.StashKey[frozenset[Path]]()
BEGUN = pytest.StashKey[float]()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--quick", type=float, metavar="SECONDS", help="only what has changed")
    parser.addoption("--write-messages", action="store_true", help="rewrite error_messages.json")


def pytest_configure(config: pytest.Config) -> None:
    """Start the clock, and find what has changed."""
    refusals.writing = config.getoption("--write-messages")
    if config.getoption("--quick") is not None:
        config.stash[BEGUN] = time.monotonic()
        config.stash[CHANGED] = changed_tests()


def pytest_unconfigure(config: pytest.Config) -> None:
    """Write the error messages of this session."""
    if refusals.writing:
        refusals.write_table()


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    chosen = config.stash.get(CHANGED, None)
    if chosen is None or any(
        one.is_relative_to(collection_path) or collection_path.is_relative_to(one) for one in chosen
    ):
        return None
    return True


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--quick") is None:
        return
    taken: Counter[Path] = Counter()
    turns: dict[pytest.Item, int] = {}
    for item in items:
        turns[item] = taken[item.path]
        taken[item.path] += 1
    items.sort(key=lambda item: turns[item])


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip a test when the time is over."""
    seconds = item.config.getoption("--quick")
    if seconds is not None and time.monotonic() - item.config.stash[BEGUN] > seconds:
        pytest.skip(f"{seconds:g} s are over")


@pytest.fixture
def own_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forget the parts that a test registers, once it has ended."""
    from planopt.channel.logs.readers import READERS
    from planopt.objectives.terms import term
    from planopt.problems.objective import RULES
    from planopt.problems.settings import PLANNERS
    from planopt.problems.tasks import TASKS

    term.registered_terms()
    monkeypatch.setattr(term, "_kinds", dict(term._kinds))
    for registry in (PLANNERS, READERS, RULES, TASKS):
        monkeypatch.setattr(registry, "registered", dict(registry.registered))


def changed_tests() -> frozenset[Path]:
    """Return the folders and files of tests for all that has changed, as far as git tells."""
    listed = subprocess.run(
        ["git", "diff", "--name-only", "HEAD~1"],
        cwd=TESTS,
        capture_output=True,
        text=True,
        check=False,
    )
    found = {TESTS / name for name in ALWAYS}
    for name in listed.stdout.splitlines():
        top, *parts = Path(name).parts
        if top in ("planopt", "tests") and parts:
            place = TESTS.joinpath(*parts)
            while not place.exists():
                place = place.parent
            found |= {place} - {TESTS}
    return frozenset(found)
