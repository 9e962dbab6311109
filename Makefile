# Two commands do everything on a fresh machine: `make demo` and `make test`. `make test` runs all
# tests but those marked slow or faults, of which it runs a small version; `make test-slow` and
# `make test-faults` run those whole.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
EXAMPLE := src/roomtables/examples/house.jsonl
DEMO   := $(VENV)/demo-tables
# Which slow tests `make test-slow` runs: all, or the files and options given.
SLOW   ?=
# The same for `make test-faults`.
FAULTS ?=

.PHONY: demo test test-slow test-faults lint household-lm clean

demo: $(VENV)/.installed-lm
	@echo "== build: p(room | object) for mpcat40, and the combinations that the example needs"
	$(BIN)/roomtables build --tables $(DEMO) --combinations $(EXAMPLE)
	@echo "== label the example scene, from the tables alone"
	$(BIN)/roomtables classify --tables $(DEMO) --input $(EXAMPLE) --offline
	@echo "== a combination that no table holds: one pass of the model"
	$(BIN)/roomtables classify --tables $(DEMO) --rule query bathtub towel mirror
	@echo "== what the tables know"
	$(BIN)/roomtables sql --tables $(DEMO) \
	  "select object, entropy_nats from entropy where source = 'proxy' order by rank limit 5"

# Where no test is collected, pytest exits with 5, and so make fails.
test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m "not slow and not faults"

test-slow: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m slow --durations=0 $(SLOW)

test-faults: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m faults --durations=0 $(FAULTS)

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

# Trains a model as the embedded one was: up to an hour on a CPU. See pipeline/household_lm/.
household-lm: $(VENV)/.installed-dev
	$(BIN)/python -m pipeline.household_lm.train

clean:
	rm -rf $(VENV) build dist

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed-%: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check \
	  --constraint constraints.txt --editable '.[$*]'
	touch $@
