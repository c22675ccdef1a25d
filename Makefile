# make demo   the main job, end to end, with pictures in demo/
# make test   everything that is checked: style, size, types, imports, tests with coverage
# make quick  the tests of what has changed since the last commit but one, for half a minute
# make bench  the benchmarks        make docs   the documentation in docs/_build/html
# make regression  the fast share of the solver regression suite
# make pictures  the pictures of README and documentation, drawn again
# make clean  removes what these make, .venv included
#
# Only Python 3.11 to 3.13 is needed. Another than python3: make demo PYTHON=python3.12

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install -qq --constraint constraints.txt
DEMO := demo
PROBLEM := munich_courier
WORKERS := 2
BENCH_OPTIONS ?=
TEST_OPTIONS ?=

# One thread a process: the processes of a comparison share the cores.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PIP_ROOT_USER_ACTION := ignore

.PHONY: demo test lint types imports tests coverage quick bench regression docs pictures clean
.DELETE_ON_ERROR:

demo: $(VENV)/.installed
	@mkdir -p $(DEMO)
	@echo "== 1. 300 measurements of the true channel of $(PROBLEM)"
	$(BIN)/python docs/take_measurements.py $(PROBLEM) $(DEMO)/log.csv
	@echo "== 2. the channel fitted to them, in closed form (convex) and by restricted likelihood"
	$(BIN)/planopt fit $(DEMO)/log.csv --station 40,0,43.5 --censored at_floor \
		--method convex --out $(DEMO)/fit_convex
	$(BIN)/planopt fit $(DEMO)/log.csv --station 40,0,43.5 --censored at_floor \
		--out $(DEMO)/fit
	@echo "== 3. the plan from the start, 10 steps ahead, and its check from the files alone"
	$(BIN)/planopt solve $(PROBLEM) --horizon 10 --out $(DEMO)/plan
	$(BIN)/planopt check $(DEMO)/plan
	@echo "== 4. the closed loop"
	$(BIN)/planopt simulate $(PROBLEM) --horizon 10 --out $(DEMO)/run
	@echo "== 5. two horizons under two costs to go, on a smaller map"
	@# Exit codes 3 and 4 say that steps were not verified and that runs stalled: results here.
	$(BIN)/planopt compare open_field --horizons 1,5 --costs-to-go geodesic,connected \
		--seeds 2 --workers $(WORKERS) --out $(DEMO)/compare || case $$? in 3|4) ;; *) exit 1 ;; esac
	@echo "== pictures"
	@find $(DEMO) -name '*.png' | LC_ALL=C sort

test: lint types imports tests

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python .ci/size_budget.py

types: $(VENV)/.installed-dev
	$(BIN)/pyright --pythonpath $(BIN)/python

imports: $(VENV)/.installed-dev
	$(BIN)/lint-imports

tests: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n 2 --benchmark-disable $(TEST_OPTIONS)

# A third slower than `make tests`.
coverage: $(VENV)/.installed-dev
	$(MAKE) tests TEST_OPTIONS="--cov --cov-report=term:skip-covered --cov-fail-under=90"

quick: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n 2 --maxschedchunk 4 --benchmark-disable --quick 25

bench: $(VENV)/.installed-bench
	$(BIN)/python -m pytest benchmarks --benchmark-sort=name $(BENCH_OPTIONS)

regression: $(VENV)/.installed
	$(BIN)/planopt bench check --workers $(WORKERS)

docs: $(VENV)/.installed-docs
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs docs/_build/html
	@echo "docs/_build/html/index.html"

# A run that is not verified throughout, or does not arrive, has a picture as well.
pictures: $(VENV)/.installed
	@for name in munich_courier crowded_track; do \
		$(BIN)/planopt simulate $$name --animation --out build/$$name \
			|| case $$? in 3|4) ;; *) exit 1 ;; esac; \
		cp build/$$name/run.png docs/pictures/$$name.png; \
		cp build/$$name/run.gif docs/pictures/$$name.gif; done

clean:
	rm -rf $(VENV) $(DEMO) build dist .coverage .coverage.* .pytest_cache .ruff_cache .benchmarks \
		.hypothesis .import_linter_cache docs/_build docs/auto_examples \
		docs/sg_execution_times.rst

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' || { \
		echo "planopt needs Python 3.11, 3.12 or 3.13; $(PYTHON) is $$($(PYTHON) --version 2> /dev/null || echo not there)." \
		"Name another: make $(MAKECMDGOALS) PYTHON=python3.12" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(PIP) --editable .
	@touch $@

$(VENV)/.installed-dev: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(PIP) --editable '.[dev]'
	@touch $(VENV)/.installed $@

$(VENV)/.installed-bench: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(PIP) --editable '.[dev,bench]'
	@touch $(VENV)/.installed $(VENV)/.installed-dev $@

$(VENV)/.installed-docs: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(PIP) --editable '.[docs]'
	@touch $(VENV)/.installed $@
