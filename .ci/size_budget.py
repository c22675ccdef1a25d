"""Check the size of the code base against its budget; exit 1 if a figure exceeds it.

Run from the project's root: python .ci/size_budget.py. A limit is raised by hand only, with the
reason in the commit message. Lines include blanks, comments and docstrings.
"""

import ast
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

BUDGET = {
    "lines": 70_917,
    "lines of code": 52_450,
    "files": 249,
    "functions": 3_809,
    "docstring lines": 7_567,
    "lines of tests": 47_720,
}
"""Largest permitted value of each figure. The goal is 55,000 lines in 240 files."""


def tracked(folder: str) -> list[Path]:
    """Return the Python files that git tracks below a folder."""
    listed = subprocess.run(["git", "ls-files", folder], capture_output=True, text=True, check=True)
    return [Path(name) for name in listed.stdout.split("\n") if name.endswith((".py", ".pyi"))]


def docstring_lines(tree: ast.Module) -> set[int]:
    """Return the numbers of the lines that docstrings occupy."""
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Module)
    return {
        line
        for node in ast.walk(tree)
        if isinstance(node, kinds) and ast.get_docstring(node)
        for line in range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1)
    }


def figures() -> dict[str, int]:
    """Return every figure of the budget."""
    total: dict[str, int] = defaultdict(int)
    for path in tracked("planopt"):
        text = path.read_text(encoding="utf-8")
        tree, lines = ast.parse(text), text.splitlines()
        documented = docstring_lines(tree)
        total["files"] += 1
        total["lines"] += len(lines)
        total["docstring lines"] += len(documented)
        total["lines of code"] += sum(
            bool(line.strip()) and not line.strip().startswith("#") and number not in documented
            for number, line in enumerate(lines, 1)
        )
        functions = (ast.FunctionDef, ast.AsyncFunctionDef)
        total["functions"] += sum(isinstance(node, functions) for node in ast.walk(tree))
    total["lines of tests"] = sum(
        len(path.read_text(encoding="utf-8").splitlines()) for path in tracked("tests")
    )
    return total


def imports_of(tree: ast.Module, modules: set[str]) -> Iterator[str]:
    """Yield the modules that a module imports, lazily or not, but for type checking only."""
    checked = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)
        for each in node.body
        for inner in ast.walk(each)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and id(node) not in checked:
            for alias in node.names:
                target = f"{node.module}.{alias.name}"
                yield target if target in modules else node.module


def import_cycle() -> list[str]:
    """Return one cycle of imports between modules; empty if there is none."""
    paths = {
        ".".join(path.with_suffix("").parts).removesuffix(".__init__"): path
        for path in tracked("planopt")
        if path.suffix == ".py"
    }
    graph = {
        name: set(imports_of(ast.parse(path.read_text(encoding="utf-8")), set(paths))) - {name}
        for name, path in paths.items()
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def main() -> int:
    """Print every figure with its limit, and return the exit code."""
    found, exceeded = figures(), False
    for name, limit in BUDGET.items():
        over = found[name] > limit
        exceeded |= over
        print(f"{name:16} {found[name]:7,} of {limit:7,}{'  EXCEEDED' if over else ''}")
    cycle = import_cycle()
    print(f"import cycle: {' -> '.join(cycle) or 'none'}")
    return int(exceeded)


if __name__ == "__main__":
    sys.exit(main())
