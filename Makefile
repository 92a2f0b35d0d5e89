# Every command of the project; CI (.ci/run) calls the same ones. `make` alone lists them.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.handctl-installed
DEMO := $(VENV)/.handctl-demo
EXTRA := $(VENV)/.handctl-extra
PYTEST ?= $(BIN)/python -m pytest
PYTEST_FLAGS ?=
# Tests of judged deadlines (marker `alone`) run last, one at a time, when the others have left the cores.
WORKERS ?= 2

.DEFAULT_GOAL := help
.PHONY: help env demo test lint kernels unit realtime wheel vcan nightly docs figures bench fuzz mutation soak golden lock clean

help: ## list these commands
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "  make %-9s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))

env: $(STAMP) ## create .venv with the locked, hashed dependencies and handctl in editable form

INSTALL = $(BIN)/python -m pip --disable-pip-version-check install --quiet

# The controller and the simulated hand: a third of what developers need.
$(DEMO): requirements-demo.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || \
	  { echo "handctl needs Python 3.11 or later as '$(PYTHON)', which is $$($(PYTHON) -V 2>&1 | head -n 1); try: make env PYTHON=python3.11" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) --require-hashes --no-deps -r requirements-demo.lock
	$(INSTALL) --no-deps --no-build-isolation --editable .
	@touch $@

$(STAMP): $(DEMO) requirements-dev.lock
	$(INSTALL) --require-hashes --no-deps -r requirements-dev.lock
	@touch $@

$(EXTRA): $(STAMP) requirements-extra.lock
	$(INSTALL) --require-hashes --no-deps -r requirements-extra.lock
	@touch $@

demo: $(DEMO) ## the arrival scenario in simulation: arm, grasp, hold, release, log, picture
	$(BIN)/handctl demo

# Of tests/slow_tests.txt, tests that cost more than SLOW_S seconds are left out, on the real clock CLOCK_SLOW_S.
SLOW_S ?= 0
CLOCK_SLOW_S ?= $(SLOW_S)
test: env ## all checks and a sample of the tests, real SocketCAN included where it can be had; SLOW_S=inf for all
	$(MAKE) -j 2 lint kernels
	HANDCTL_SLOW_S=$(SLOW_S) $(MAKE) unit
	HANDCTL_SLOW_S=$(CLOCK_SLOW_S) $(MAKE) realtime

lint: env ## ruff with its formatter, mypy --strict, the import contracts, and limits on dialect
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache
	$(BIN)/python tools/language.py

# Otherwise each worker of the next stage compiles the same functions in its first test.
kernels: env
	$(BIN)/python -c 'import handctl.session.run, handctl.compiled; handctl.compiled.compile_kernels()'

# A process has one core: threads of BLAS would wait for each other by spinning.
unit: export OPENBLAS_NUM_THREADS = 1
unit: env
	$(PYTEST) -n $(WORKERS) -m "not realtime" $(PYTEST_FLAGS)

realtime: env
	$(PYTEST) -n $(WORKERS) --dist loadfile -m "realtime and not alone" $(PYTEST_FLAGS)
	$(PYTEST) -m alone $(PYTEST_FLAGS)

wheel: export HANDCTL_NIGHTLY = 1
wheel: env ## the wheel in a fresh environment with packages from the index; a few minutes
	$(PYTEST) tests/contracts/test_wheel.py $(PYTEST_FLAGS)

vcan: env ## the SocketCAN tests alone, on the kernel's vcan or in user-mode Linux
	HANDCTL_REQUIRE_VCAN=1 $(PYTEST) tests/vcan $(PYTEST_FLAGS)

nightly: export HANDCTL_NIGHTLY = 1
nightly: export OPENBLAS_NUM_THREADS = 1
nightly: lint ## the tests with full counts: long property runs, fault campaigns, soak
	$(PYTEST) -n $(WORKERS) -m "not realtime" $(PYTEST_FLAGS)
	$(MAKE) realtime

docs: env ## the documentation site in build/site, without the network; a dead link is an error
	$(BIN)/python -m tools.reference
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict
	@echo "the site is in build/site; to read it: $(BIN)/python -m http.server -d build/site"

figures: env ## the figures of README and site, and the demo's numbers, from runs in lockstep; NAMES= for some of them
	MUJOCO_GL=egl $(BIN)/python -m tools.figures $(NAMES)

bench: $(EXTRA) ## side by side with what a user would pick instead; prints ratios
	@set -e; for script in benchmarks/*.py; do echo "== $$script"; $(BIN)/python "$$script"; done

# `make fuzz RUNS=10000000 SECONDS=0 BLIND=--blind` for the count that is asked for; TARGETS="mit log" for some of them.
SECONDS ?= 10
RUNS ?= -1
fuzz: $(EXTRA) ## every parser against mutated input; SECONDS= (10) or RUNS= for each, TARGETS=
	$(BIN)/python -m fuzz --seconds $(SECONDS) --runs $(RUNS) $(BLIND) $(TARGETS)

mutation: $(EXTRA) ## mutants of safety, decoders, checks and filter; survivors against docs/evidence/mutation.md
	rm -rf mutants
	mkdir -p build
	$(BIN)/mutmut run --max-children $(WORKERS) > build/mutation.txt 2>&1 || { tail -n 20 build/mutation.txt; exit 1; }
	$(BIN)/python -m fuzz.mutation_survivors

# The whole of it would be `make soak HOURS=24`, which nobody has run yet (docs/evidence/soak.md).
HOURS ?= 0.05
soak: env ## simulator and controller in real time for HOURS=, a random fault a minute; memory and descriptors judged
	$(BIN)/python -m fuzz.soak --hours $(HOURS)

golden: env ## write the golden logs anew, after a change of the controller that is meant
	$(BIN)/python -m tests.replay.golden_logs logs/golden

lock: env ## write the lock files anew; LOCK_FLAGS=--upgrade takes newer releases
	$(LOCK) pyproject.toml --output-file requirements.lock
	$(LOCK) pyproject.toml --extra sim --group build --constraint requirements.lock --output-file requirements-demo.lock
	$(LOCK) pyproject.toml --extra all --group dev --constraint requirements-demo.lock --output-file requirements-dev.lock
	$(LOCK) pyproject.toml --extra all --group dev --group extra --constraint requirements-dev.lock --output-file requirements-extra.lock
	@set -e; for python in 3.11 3.12 3.13; do $(RESOLVE) --python-version $$python -r requirements-extra.lock; done

# One version for all Pythons (fork-strategy fewest), so that numbers agree between them.
RESOLVE = $(BIN)/uv pip install --quiet --no-config --dry-run --require-hashes --only-binary :all: --target build/resolved
LOCK = $(BIN)/uv pip compile --quiet --no-config --universal --python-version 3.11 --fork-strategy fewest \
  --generate-hashes --custom-compile-command "make lock" $(LOCK_FLAGS)

clean: ## remove the environment and everything that was generated, but no log
	rm -rf $(VENV) build dist mutants .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find src firmware_sim tests benchmarks fuzz -name __pycache__ -type d -prune -exec rm -rf {} + 2>/dev/null || true
