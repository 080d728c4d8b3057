# SPDX-License-Identifier: Apache-2.0
# make demo · make test · make lint · make bench: each sets up all it needs.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# How many tests run side by side; many wait for a cluster most of the time.
WORKERS ?= 3
# Which tests; all when empty.
TESTS ?=
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: demo test test-packages constraints cluster-build cluster-up cluster-down images lint bench fuzz fuzz-api honest install crds clean help

help:
	@echo 'make demo    compare real algorithms on a generated recording'
	@echo 'make test    run all tests'
	@echo 'make lint    style, types, layers'
	@echo 'make images  build the container images'
	@echo 'make cluster-up, cluster-down   a real Kubernetes for tests, on this machine'
	@echo 'make fuzz    ten minutes of broken files for all readers'
	@echo 'make fuzz-api   five minutes of made-up questions for the API'
	@echo 'make honest  every view of results beside their definition, over 5,000 made-up archives'
	@echo 'make bench   speed and memory, beside the limits'

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo 'slamhive needs Python 3.11 or newer: make PYTHON=python3.12 …'; exit 2; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || \
	  { [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null && apt-get install -y -q python3-venv; } || \
	  { echo 'Python has no venv module: sudo apt-get install python3-venv'; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade 'pip>=25.1'
	$(BIN)/python -m pip install --quiet --editable . --group dev --constraint constraints.txt
	@touch $@

install: $(STAMP)

demo: $(STAMP)
	$(BIN)/slamhive demo

test: $(STAMP) test-packages cluster-build
	@$(BIN)/python -m pytest -n $(WORKERS) --no-loadscope-reorder $(TESTS) || { \
	  [ $$? = 1 ] && echo 'Once more, alone, what failed side by side:' && \
	  $(BIN)/python -m pytest --last-failed --last-failed-no-failures none --maxfail 5 -v $(TESTS); }

# What the test cluster is made of; without root, Go or Debian its tests are skipped and say how to have them.
cluster-build:
	@$(PYTHON) tests/cluster/cluster.py prepare
cluster-up:
	@$(PYTHON) tests/cluster/cluster.py up
cluster-down:
	@$(PYTHON) tests/cluster/cluster.py down

images: $(STAMP)
	$(BIN)/python images/build $(IMAGES)

test-packages:
	@tests/install-packages

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	cd images && ../$(BIN)/mypy --strict building
	$(BIN)/lint-imports --no-logo 2>/dev/null || $(BIN)/lint-imports

bench: $(STAMP)
	$(BIN)/python tests/bench/run.py

fuzz: $(STAMP)
	$(BIN)/python tests/fuzz/readers.py --seconds 600

fuzz-api: $(STAMP)
	$(BIN)/python tests/fuzz/api.py --seconds 300

honest: $(STAMP)
	$(BIN)/python tests/honest/check.py --archives 5000

# The newest versions that fit, for the next machines to install.
constraints:
	$(PYTHON) -m venv --clear $(VENV)/fresh
	$(VENV)/fresh/bin/python -m pip install --quiet --upgrade 'pip>=25.1'
	$(VENV)/fresh/bin/python -m pip install --quiet --editable . --group dev
	{ sed -n '/^#/p' constraints.txt; $(VENV)/fresh/bin/python -m pip freeze --exclude-editable; } > $(VENV)/constraints.txt
	mv $(VENV)/constraints.txt constraints.txt
	rm -rf $(VENV)/fresh

# The CRDs from the models, and the chart's copies of them and of the catalog.
crds: $(STAMP)
	$(BIN)/python -m slamhive.model.crd crds
	SLAMHIVE_UPDATE=1 $(BIN)/python -m pytest -q tests/helm -k copies

clean:
	rm -rf $(VENV) build dist .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
