# `make reproduce` and `make test` need only Python 3.11 or newer and make: each sets up what it uses.
#
# PYTHON=python3.12 make test   takes another interpreter; the first of these that is new enough is the default.
# JOBS=4 make test              runs the tests on more processes.
# STEPS=1000000 make soak       plays longer.

PYTHON ?= $(shell for python in python3 python3.11 python3.12 python3.13 python3.14 python; do \
	if $$python -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then echo $$python; break; fi; done)
JOBS ?= 2
OUT ?= fsar-out
STEPS ?= 100000

BIN := .venv/bin
READY := .venv/.ready

.DEFAULT_GOAL := help
.PHONY: help setup reproduce test check soak bench docs clean

help:
	@echo "make setup      a .venv with the command fsar-ledger in it"
	@echo "make reproduce  simulate the paper's experiment, measure it, typeset the report into $(OUT)/"
	@echo "make test       every check and every test"
	@echo "make check      the checks without the tests: style, types, imports, SQL"
	@echo "make soak       100,000 random steps of random fleets: ten invariants, live state = rebuilt state (minutes)"
	@echo "make bench      the four benchmarks, as ratios"
	@echo "make docs       write the pages that hold real output again"
	@echo "make clean      remove what the other targets made"

setup: $(READY)

# One stamp for the whole set-up: it is written last, so that an interrupted set-up is done again.
$(READY): requirements.txt pyproject.toml
	@if [ -z "$(PYTHON)" ]; then echo "make: no Python 3.11 or newer found; install one, or name it: make PYTHON=/path/to/python3" >&2; exit 2; fi
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip --disable-pip-version-check install --quiet --require-hashes -r requirements.txt
	$(BIN)/python -m pip --disable-pip-version-check install --quiet --no-deps --no-build-isolation -e .
	@touch $(READY)

reproduce: setup
	$(BIN)/fsar-ledger reproduce --out $(OUT)

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy --strict fsar_ledger tests benchmarks docs
	$(BIN)/sqlfluff lint --disable-progress-bar queries
	$(BIN)/lint-imports

test: check
	$(BIN)/pytest -n $(JOBS)

soak: setup
	$(BIN)/python -m tests.runtime.test_federation_model $(STEPS)

bench: setup
	$(BIN)/python benchmarks/simulate_and_append.py
	$(BIN)/python benchmarks/metrics.py
	$(BIN)/python benchmarks/registry_lookup.py
	$(BIN)/python benchmarks/inclusion_proof.py

docs: reproduce
	$(BIN)/python docs/write.py
	$(BIN)/python -c 'from pathlib import Path; from fsar_ledger.report import result_figure_svg; result_figure_svg(Path("$(OUT)/ledger"), Path("docs/results.svg"))'

clean:
	rm -rf .venv $(OUT) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
