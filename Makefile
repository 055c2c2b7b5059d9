# Each target does all the set-up it needs; `make` alone lists them.

SCENARIO ?= academy_3_vs_1_with_keeper
PRESET ?= light
FRAMES ?= 400000
SEED ?= 0
# More options for fbrl-train, e.g. ARGS="--num-envs 4 --device cpu", or for bench
ARGS ?=

BIN := .venv/bin
MAKEFLAGS += --no-print-directory
.DEFAULT_GOAL := help
.PHONY: help setup train test lint docs dist engine-wheel bench clean

help: ## List the targets
	@echo "Targets:"
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1|\2/p' Makefile | awk -F'|' '{printf "%-18s %s\n", $$1, $$2}'
	@echo "Variables of train: SCENARIO=$(SCENARIO) PRESET=$(PRESET) FRAMES=$(FRAMES) SEED=$(SEED) ARGS=\"$(ARGS)\""
	@echo "Variables of set-up: PYTHON, TORCH, NO_APT=1; see the head of scripts/setup.sh"

setup: ## System packages, .venv, engine and fbrl; skips what is done (others imply it)
	@scripts/setup.sh

train: setup ## Train an agent and evaluate it: SCENARIO, PRESET, FRAMES, SEED, ARGS
	$(BIN)/fbrl-train $(SCENARIO) --preset $(PRESET) --total-frames $(FRAMES) --seed $(SEED) \
		--eval-untrained $(ARGS)

lint: setup ## Style, format and type checks, and known vulnerabilities of what is installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/shellcheck --external-sources scripts/setup.sh scripts/setup/*.sh .ci/run \
		experiments/sweep/slurm.sh
	$(BIN)/python scripts/audit.py

test: lint ## All checks: lint and the test suite
	OMP_WAIT_POLICY=PASSIVE $(BIN)/pytest --numprocesses auto --maxprocesses 2 --dist loadfile \
		--durations 10

docs: setup ## Build the site into build/docs; a warning is an error
	$(BIN)/sphinx-build -W --keep-going -b html docs build/docs
	@echo "Site: build/docs/index.html"

dist: setup ## Build the wheel and the source distribution into dist/, and check them
	rm -f dist/*.whl dist/*.tar.gz
	$(BIN)/python -m build
	$(BIN)/twine check --strict dist/*.whl dist/*.tar.gz
	$(BIN)/pytest tests/test_wheel.py tests/test_fresh_install.py

engine-wheel: ## Build the engine for other machines, into dist/engine: PYTHON
	@scripts/setup.sh --portable-wheels

bench: setup ## Measure the speed against its peers and write docs/performance.md: ARGS="--quick"
	@scripts/setup.sh --default-engine
	$(BIN)/python -m benchmarks $(ARGS)

clean: ## Remove .venv and build leftovers (not runs/, not the cache of compiled engines)
	rm -rf .venv .nox build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
