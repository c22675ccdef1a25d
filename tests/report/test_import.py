"""Matplotlib is loaded where figures are drawn, not where they are imported."""

import pkgutil
import subprocess
import sys

import planopt.report


def test_import_leaves_matplotlib_alone():
    """Importing every module of the package loads no part of matplotlib."""
    modules = [
        f"planopt.report.{found.name}" for found in pkgutil.iter_modules(planopt.report.__path__)
    ]
    assert len(modules) > 10
    code = (
        f"import sys, {', '.join(modules)}\n"
        "print(any(name.split('.')[0] == 'matplotlib' for name in sys.modules))"
    )
    answer = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert answer.stdout.strip() == "False"
