# `make reproduce` and `make test` need only Python 3.11 or newer and make: each sets up what it uses.
#
# PYTHON=python3.12 make test   takes another interpreter; the first of these that is new enough is the default.
# JOBS=4 make test              runs the tests on more processes.
# STEPS=1000000 make soak-federation   plays longer.

PYTHON ?= $(shell for python in python3 python3.11 python3.12 python3.13 python3.14 python; do \
	if $$python -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then echo $$python; break; fi; done)
JOBS ?= 2
OUT ?= fsar-out
STEPS ?= 100000

# Tests start processes by the hundred: what is compiled once is kept, whatever the shell says.
unexport PYTHONDONTWRITEBYTECODE

BIN := .venv/bin
READY := .venv/.ready

.DEFAULT_GOAL := help
.PHONY: help setup reproduce test check check-style check-types check-sql check-imports soak soak-tests soak-federation soak-crash soak-damage soak-verifier soak-agreement soak-flips soak-readers soak-reverts soak-swaps soak-sensitivity bench docs sbom clean

help:
	@echo "make setup      a .venv with the command fsar-ledger in it"
	@echo "make reproduce  simulate the paper's experiments, measure them, typeset the report into $(OUT)/"
	@echo "make test       every check and every test"
	@echo "make check      the checks without the tests: style, types, imports, SQL"
	@echo "make soak       the long tests, over an hour: make soak-tests, -federation, -crash, -damage, -verifier, -agreement, -flips, -readers, -reverts, -swaps are its parts"
	@echo "make soak-sensitivity   how much of each number hangs on each constant, most of an hour; goes on where it was interrupted"
	@echo "make bench      the benchmarks, as ratios"
	@echo "make docs       write the pages that hold real output again"
	@echo "make sbom       the software bill of materials, CycloneDX 1.6, into dist/fsar-ledger.cdx.json"
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

# The checks one beside the other: the types take as long as all the rest.
check: setup
	@$(MAKE) --no-print-directory -j 2 check-types check-style check-imports check-sql

check-style:
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

check-types:
	$(BIN)/mypy --strict fsar_ledger tests benchmarks docs .ci/sbom.py

check-sql:
	$(BIN)/sqlfluff lint --disable-progress-bar queries

check-imports:
	$(BIN)/lint-imports

test: check
	$(BIN)/pytest -n $(JOBS) --dist worksteal

soak: soak-tests soak-federation soak-crash soak-damage soak-verifier soak-agreement soak-flips soak-readers soak-reverts soak-swaps

# The tests that make test leaves out because they take minutes.
soak-tests: setup
	$(BIN)/pytest -n $(JOBS) -m slow

# 100,000 random steps of random fleets: ten invariants hold, live state = rebuilt state.
soak-federation: setup
	$(BIN)/python -m tests.runtime.test_federation_model $(STEPS)

# Faults at every call of an append and of the recovery from it, power failures, 2,000 processes killed: nothing lost, nothing torn.
soak-crash: setup
	$(BIN)/python -m tests.ledger.crash_soak

# Every bit flipped and every length cut of every file of a ledger: all found, each with its place.
soak-damage: setup
	$(BIN)/python -m tests.ledger.damage_soak

# Each check of the verifier taken out once: a test fails.
soak-verifier: setup
	$(BIN)/python -m tests.ledger.mutate_verifier

# The verifier that shares nothing with the package, and verify, on 1,200 good and damaged ledgers.
soak-agreement: setup
	$(BIN)/python -m tests.ledger.agreement_soak 1200

# 2,000 single bits flipped over all files of a ledger, and then every command that answers from it: refused, or the right answer.
soak-flips: setup
	$(BIN)/python -m tests.ledger.flips_soak 2000

# 100,000 segments whose footer or page headers say something else: each is refused, or read alike by pyarrow, DuckDB and Polars.
soak-readers: setup
	$(BIN)/python -m tests.ledger.readers_soak

# Each fix that is on record in tests/reverts taken out alone: its test fails by its own assertion.
soak-reverts: setup
	$(BIN)/python -m tests.reverts.soak

# Every two arguments that could be mistaken for each other, wherever an event is made, swapped once: the type checker, a run or a test finds it.
soak-swaps: setup
	$(BIN)/python -m tests.swaps.soak

# Every constant, the load and the size of the fleet varied: which cell each of them moves, and how far. No test; the fit makes it worth doing again.
soak-sensitivity: setup
	$(BIN)/fsar-ledger sensitivity --out $(OUT)/sensitivity.parquet --svg $(OUT)/sensitivity.svg

bench: setup
	$(BIN)/python benchmarks/command_line.py
	$(BIN)/python benchmarks/simulate_and_append.py
	$(BIN)/python benchmarks/metrics.py
	$(BIN)/python benchmarks/registry_lookup.py
	$(BIN)/python benchmarks/inclusion_proof.py
	$(BIN)/python benchmarks/trust.py
	$(BIN)/python benchmarks/growth.py --maps

docs: reproduce
	$(BIN)/python docs/write.py
	$(BIN)/python -c 'from pathlib import Path; from fsar_ledger.report import result_figure_svg; result_figure_svg(Path("$(OUT)/results"), Path("docs/results.svg"))'

# What the package and its tests are made of: versions, hashes and licences of all that requirements.txt installs.
sbom: setup
	$(BIN)/python .ci/sbom.py dist/fsar-ledger.cdx.json

clean:
	rm -rf .venv $(OUT) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
