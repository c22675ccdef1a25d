"""Pages in a headless browser; tests are skipped where none is installed."""

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest


@contextlib.contextmanager
def opened(file: Path) -> Iterator[tuple[Any, list[str]]]:
    """Open a file at the width of a phone; yield page and console messages."""
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as drivers:
        # An installed browser is used if the driver has none of its own.
        found = shutil.which("chromium-headless-shell") or shutil.which("chromium")
        try:
            browser = drivers.chromium.launch(args=["--no-sandbox"], executable_path=found)
        except playwright.Error as error:
            pytest.skip(f"no Chromium: {error}")
        page = browser.new_page(viewport={"width": 390, "height": 844})
        messages: list[str] = []
        page.on("console", lambda message: messages.append(message.text))
        page.on("pageerror", lambda error: messages.append(str(error)))
        page.goto(file.absolute().as_uri())
        yield page, messages
        browser.close()
