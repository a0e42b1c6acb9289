# `make reproduce` and `make test` need a POSIX system (Linux, macOS), Python 3.11 or newer, and make. Each installs
# what it uses: `reproduce` requirements.txt, `test` also requirements-test.txt, `test-all` also requirements-all.txt.
#
# PYTHON=python3.12 make test   uses another interpreter; the default is the first of these that is new enough.
# JOBS=4 make test              runs the tests in more processes.
# STEPS=1000000 make soak-federation   plays longer.
# MINUTES=6 make soak-load             is done sooner; so is TASKS=50000 make soak-tests.

PYTHON ?= $(shell for python in python3 python3.11 python3.12 python3.13 python3.14 python; do \
	if $$python -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then echo $$python; break; fi; done)
JOBS ?= 2
OUT ?= fsar-out
STEPS ?= 100000
MINUTES ?= 30
TASKS ?= 200000

# Recipes read it from their environment, quoted, since a folder may have any name.
export OUT MINUTES TASKS

# Tests start hundreds of processes: keep compiled modules, whatever the shell says.
unexport PYTHONDONTWRITEBYTECODE

BIN := .venv/bin
# What is never imported need not be compiled: that took two fifths of the set-up.
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet --no-compile

# A stamp for each set-up, written last: a set-up that was interrupted is done again.
READY := .venv/.ready
READY_TEST := .venv/.ready-test
READY_ALL := .venv/.ready-all

SOAKS := soak-tests soak-federation soak-load soak-crash soak-beside soak-damage soak-verifier soak-agreement soak-flips soak-readers \
	soak-foreign soak-reverts soak-swaps

.DEFAULT_GOAL := help
.PHONY: help setup reproduce test test-all test-rest check check-style check-types check-sql check-imports soak $(SOAKS) \
	soak-sensitivity fleets systems bench docs page pins sbom clean

help:
	@echo "make setup       create .venv with the command fsar-ledger in it"
	@echo "make reproduce   simulate the paper's experiments, measure them, typeset the report into $$OUT/"
	@echo "make test        run every check and the tests, 5 minutes; skips tests that need an extra, and says so"
	@echo "make test-all    install the extras and run all tests but the soaks, 25 minutes; a skipped test is a failure"
	@echo "make check       run the checks without the tests: style, types, imports, SQL"
	@echo "make soak        run the long tests, for hours: $(SOAKS)"
	@echo "make soak-sensitivity   measure how much each number depends on each constant, most of an hour;"
	@echo "                 resumes where it was interrupted"
	@echo "make fleets      measure what coordination costs in fleets of 4 to 4,096 robots, into $$OUT/fleets.pdf;"
	@echo "                 40 minutes and 9 GiB; resumes where it was interrupted"
	@echo "make systems     run six architectures, three of them published systems, into $$OUT/systems.json; 15 minutes;"
	@echo "                 resumes where it was interrupted"
	@echo "make bench       run the benchmarks and print ratios"
	@echo "make docs        rewrite the pages that show real output"
	@echo "make page        build the script of the page that view writes from fsar_ledger/view/src; needs Node"
	@echo "make pins        pin the versions in requirements*.in again; needs uv"
	@echo "make sbom        write the software bill of materials, CycloneDX 1.6, to dist/fsar-ledger.cdx.json"
	@echo "make clean       remove what the other targets made"

setup: $(READY)

$(READY): requirements.txt pyproject.toml $(wildcard fsar_ledger/*/*.c fsar_ledger/*/*/*.c)
	@if [ -z "$(PYTHON)" ]; then \
		echo "make: no Python 3.11 or newer found; install one, or name it: make PYTHON=/path/to/python3" >&2; \
		exit 2; fi
	$(PYTHON) -m venv .venv
	$(PIP) --require-hashes -r requirements.txt
	$(PIP) --no-deps --no-build-isolation -e .
	@touch $@

$(READY_TEST): requirements-test.txt $(READY)
	$(PIP) --require-hashes -r requirements-test.txt
	@touch $@

$(READY_ALL): requirements-all.txt $(READY_TEST) fsar_ledger/view/src/package-lock.json
	$(PIP) --require-hashes -r requirements-all.txt
	.ci/browser
	$(BIN)/python .ci/page.py --check
	@touch $@

reproduce: $(READY)
	$(BIN)/fsar-ledger reproduce --out "$$OUT"

# Two checks at a time: the types take as long as all the others.
check: $(READY_TEST)
	@$(MAKE) --no-print-directory -j 2 check-types check-style check-imports check-sql

check-style: $(READY_TEST)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

check-types: $(READY_TEST)
	$(BIN)/mypy --strict fsar_ledger tests benchmarks docs .ci/sbom.py .ci/pin.py .ci/page.py

check-sql: $(READY_TEST)
	$(BIN)/sqlfluff lint --disable-progress-bar queries

check-imports: $(READY_TEST)
	$(BIN)/lint-imports

test: check
	$(BIN)/pytest -n $(JOBS) --dist worksteal -rs

test-all: $(READY_ALL) check
	$(BIN)/pytest -n $(JOBS) --dist worksteal -m "not soak" --no-skips

# What test-all runs beyond test, after that: the slow tests, and those that it skipped.
test-rest: $(READY_ALL)
	$(BIN)/pytest -n $(JOBS) --dist worksteal -m "not soak" --left-out --no-skips

soak: $(SOAKS)

# The tests that make test-all leaves out because each takes minutes.
soak-tests: $(READY_TEST)
	$(BIN)/pytest -n $(JOBS) -m soak --ignore tests/service/test_load.py

# Take 200,000 random steps in random fleets whose robots leave and return: the ten invariants hold, nothing waits for who
# has left, and the live state equals the rebuilt one.
soak-federation: $(READY_TEST)
	$(BIN)/python -m tests.runtime.test_federation_model $(STEPS)

# Put the service under load for so many minutes: what it has done leaves nothing in its memory.
soak-load: $(READY_ALL)
	$(BIN)/pytest -s -m soak tests/service/test_load.py

# Inject a fault at every call of an append and of its recovery, cut the power, kill 2,000 processes, of
# appends, the journal, sealing and compaction: nothing is lost, nothing torn.
soak-crash: $(READY_TEST)
	$(BIN)/python -m tests.ledger.crash_soak

# Kill 500 writers and refuse 500 writes while readers open the ledger all the time: each sees what is committed, once and
# for ever, and nothing else.
soak-beside: $(READY_TEST)
	$(BIN)/python -m tests.ledger.readers_beside_soak

# Flip every bit of every file of a ledger and cut it at every length: each is found, with its place, but for what a
# crash may leave of a ledger that was not closed.
soak-damage: $(READY_TEST)
	$(BIN)/python -m tests.ledger.damage_soak

# Remove each check of the verifier once: a test fails.
soak-verifier: $(READY_TEST)
	$(BIN)/python -m tests.ledger.mutate_verifier

# Compare verify with a verifier that shares no code with the package, on 1,200 good and damaged ledgers.
soak-agreement: $(READY_TEST)
	$(BIN)/python -m tests.ledger.agreement_soak 1200

# Flip 2,000 single bits of a ledger, one at a time, and call every command that answers: it refuses, or
# its answer is right.
soak-flips: $(READY_TEST)
	$(BIN)/python -m tests.ledger.flips_soak 2000

# Forge the footer or page headers of 100,000 segments: each is refused, or pyarrow, DuckDB and Polars read it alike.
soak-readers: $(READY_TEST)
	$(BIN)/python -m tests.ledger.readers_soak

# Give 100,000 random events of other systems to every verb: no traceback, and no claim about what was not observed.
soak-foreign: $(READY_TEST)
	$(BIN)/python -m tests.foreign.soak

# Revert each fix on record in tests/reverts alone: its test fails by its own assertion.
soak-reverts: $(READY_TEST)
	$(BIN)/python -m tests.reverts.soak

# Swap once every two arguments that could be mistaken for each other, wherever an event is made: the type checker, a
# run or a test finds it.
soak-swaps: $(READY_TEST)
	$(BIN)/python -m tests.swaps.soak

# Vary every constant, the load and the fleet size: which cell does each move, and how far? Not a test; repeat it after
# a fit.
soak-sensitivity: $(READY)
	$(BIN)/fsar-ledger study run sensitivity --out "$$OUT/sensitivity.json" --svg "$$OUT/sensitivity.svg"

# What do RoboOS, JADE and ALLIANCE do in the worlds of the paper's three? Resumes where it was interrupted.
systems: $(READY)
	$(BIN)/fsar-ledger study run systems --out "$$OUT/systems.json"

# Which size breaks which architecture, and what does a request cost there? Not a test; 62 million events, 10 GiB.
fleets: reproduce
	for size in 4 16 64 256 1024 4096; do \
		$(BIN)/fsar-ledger simulate "$$OUT/fleets" --runs 1 --scenario door-relay --fleet-size $$size || exit; \
	done
	$(BIN)/fsar-ledger report "$$OUT/results" --with "$$OUT/fleets" --out "$$OUT/fleets.pdf" --memory 10240

bench: export FSAR_LEDGER_BENCH := $(OUT)/bench.jsonl
bench: $(READY_TEST)
	@mkdir -p "$$OUT" && rm -f "$$FSAR_LEDGER_BENCH"
	$(BIN)/python benchmarks/command_line.py
	$(BIN)/python benchmarks/simulate_and_append.py
	$(BIN)/python benchmarks/kernel.py
	$(BIN)/python benchmarks/journal.py
	$(BIN)/python benchmarks/small_commits.py
	$(BIN)/python benchmarks/door.py
	$(BIN)/python benchmarks/one_run.py
	$(BIN)/python benchmarks/verify.py
	$(BIN)/python benchmarks/metrics.py
	$(BIN)/python benchmarks/rows.py
	$(BIN)/python benchmarks/registry_lookup.py
	$(BIN)/python benchmarks/inclusion_proof.py
	$(BIN)/python benchmarks/trust.py
	$(BIN)/python benchmarks/growth.py --maps
	$(BIN)/python benchmarks/every_command.py --events 200000
	$(BIN)/python benchmarks/page.py || true  # where Chromium or Playwright is lacking
	$(BIN)/python benchmarks/table.py "$$FSAR_LEDGER_BENCH"

docs: reproduce $(READY_TEST)
	$(BIN)/python docs/write.py
	$(BIN)/python -c 'import os; from pathlib import Path; from fsar_ledger.report.build import Document, gather; \
		drawings = Document(gather(Path(os.environ["OUT"]) / "results")).drawings; \
		Path("docs/results.svg").write_bytes(drawings["evaluation-results.svg"])'

# The script and the style of the page that `fsar-ledger view` writes, from their sources.
page: $(READY)
	$(BIN)/python .ci/page.py

# The versions and hashes that the three set-ups install.
pins: $(READY)
	$(BIN)/python .ci/pin.py

# Versions, hashes and licences of what the package and its tests are made of.
sbom: $(READY_TEST)
	$(BIN)/python .ci/sbom.py dist/fsar-ledger.cdx.json

clean:
	rm -rf .venv "$$OUT" build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
