# SPDX-License-Identifier: Apache-2.0
# make demo · make test · make lint · make bench: each sets up all it needs.
VENV := .venv
BIN := $(VENV)/bin
# The environment keeps its Python as long as that runs and no other is asked for.
PYTHON ?= $(shell $(BIN)/python -c 'print("$(BIN)/python")' 2>/dev/null || echo python3)
JAVASCRIPT := tests/javascript
JAVASCRIPT_STAMP := $(JAVASCRIPT)/node_modules/.installed
# Node.js comes with the Python packages.
NPM := cd $(JAVASCRIPT) && PATH="$(CURDIR)/$(BIN):$$PATH" npm
# How many tests run side by side; many wait most of the time, for a program or a cluster.
WORKERS ?= 4
# Which tests; all when empty.
TESTS ?=
THE_REST := cluster or container or helm or image or ros or slow
# Those that several tests run: built before them, as a test's own time is bounded.
TEST_IMAGES := slamhive evaluator kiss-icp genz-icp shell-algorithm ros1-player kiss-icp-ros ros2-player kiss-icp-ros2
pytest = $(BIN)/python -m pytest -n $(WORKERS) $(1) $(TESTS)
# Otherwise pytest would compile all tests anew in each worker, each time.
unexport PYTHONDONTWRITEBYTECODE
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: demo test test-cluster test-all test-packages test-images pins cluster-build cluster-up cluster-down images dist release docs lint bench bench-scale fuzz fuzz-api fuzz-cluster coverage honest doctor audit install demo-environment crds clean help

help:
	@echo 'make demo    compare real algorithms on a generated recording'
	@echo 'make test    run the quick tests, which need neither root nor a cluster'
	@echo 'make test-cluster   run the rest: on a real Kubernetes, with images, with ROS nodes (Debian, root, Go), the slow ones'
	@echo 'make test-all   both, in one session'
	@echo 'make lint    style, types, layers, words'
	@echo 'make docs    the docs site, in site/'
	@echo 'make images  build the container images'
	@echo 'make dist    wheels and source distributions of slamhive and slamhive-eval'
	@echo 'make release  all files of a release, made twice and compared: packages, charts, images, SBOMs, checksums'
	@echo 'make pins    versions and hashes of all Python packages'
	@echo 'make audit   known vulnerabilities of all packages'
	@echo 'make cluster-up, cluster-down   a real Kubernetes for tests, on this machine'
	@echo 'make fuzz    ten minutes each of broken files for all readers, servers that lie and made-up archives, then many made-up inputs for all else'
	@echo 'make fuzz-api   five minutes of made-up questions for the API, over 80,000 runs'
	@echo 'make fuzz-cluster   the operator killed, and sweeps deleted, at each single side effect; all behaviours in containers'
	@echo 'make coverage   which modules make test covers by less than 80 %, lines and branches'
	@echo 'make honest  every view of results beside their definition, over 5,000 made-up archives'
	@echo 'make doctor  clean recordings that must be left alone, and faults of known size that must be found'
	@echo 'make bench   speed and memory, beside the limits'
	@echo 'make bench-scale   one Sweep of 80,000 played runs (hours); ARGS=2000 for fewer'

# Looks whether the environment is as it should be, and makes it where it is not, by uv or else pip.
# Everything is enough for the demo too.
install demo-environment:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo 'slamhive needs Python 3.11 or newer: make PYTHON=python3.12 …'; exit 2; }
	@PYTHONPATH=operator $(PYTHON) tools/checkout.py $(VENV) \
	  $(if $(filter install,$@),all,demo)

# Biome and TypeScript, as the lock file has them; make lint alone needs them.
$(JAVASCRIPT_STAMP): $(JAVASCRIPT)/package.json $(JAVASCRIPT)/package-lock.json | install
	$(NPM) ci --ignore-scripts --no-audit --no-fund --loglevel=error
	@touch $@

demo: demo-environment
	$(BIN)/slamhive demo

# Neither root nor a cluster: those tests are the next command's.
test: install
	$(call pytest,-m 'not ($(THE_REST))')

test-cluster: install test-packages cluster-build test-images
	$(call pytest,-m '$(THE_REST)')

# Both at once: what waits for a cluster goes beside what computes.
test-all: install test-packages cluster-build test-images
	$(call pytest)

# What the test cluster is made of; without root, Go or Debian its tests are skipped and say how to have them.
cluster-build:
	@$(PYTHON) tests/cluster/cluster.py prepare
# What containers of tests run; what is up to date is not built again. Without root or buildah their tests are
# skipped and say why, as they do for an image that can't be built.
test-images: install
	@[ "$$(id -u)" != 0 ] || ! command -v buildah >/dev/null || \
	  $(BIN)/python images/build --tool buildah $(TEST_IMAGES) || true
cluster-up:
	@$(PYTHON) tests/cluster/cluster.py up
cluster-down:
	@$(PYTHON) tests/cluster/cluster.py down

images: install
	$(BIN)/python images/build $(IMAGES)

test-packages:
	@tests/install-packages

# Source distributions and wheels of slamhive and slamhive-eval.
dist: install
	cd evaluator && ../$(BIN)/python -m hatchling build --directory ../dist
	$(BIN)/python -m hatchling build --directory dist

# All files of a release, in dist/release/, made twice from the commit and compared. IMAGES=none leaves out what takes
# minutes each.
release: install
	@$(BIN)/python tools/release.py $(IMAGES)

# The docs site, in site/.
docs: install
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

lint: install $(JAVASCRIPT_STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/mypy tools
	cd images && ../$(BIN)/mypy --strict building
	$(BIN)/lint-imports --no-logo 2>/dev/null || $(BIN)/lint-imports
	$(BIN)/python tests/tree/check.py
	$(NPM) run --silent lint

bench: install
	$(BIN)/python tests/bench/run.py

bench-scale: install
	$(BIN)/python tests/bench/scale.py $(ARGS)

fuzz: install
	$(BIN)/python tests/fuzz/readers.py --seconds 600
	$(BIN)/python tests/fuzz/servers.py --seconds 600
	$(BIN)/python tests/fuzz/archives.py --seconds 600
	SLAMHIVE_EXAMPLES=thorough $(BIN)/python -m pytest -m hypothesis $(TESTS)

fuzz-api: install
	$(BIN)/python tests/fuzz/api.py --seconds 300

# make test-cluster takes one side effect, and one behaviour, of each kind.
fuzz-cluster: install test-packages cluster-build
	SLAMHIVE_EXAMPLES=thorough $(BIN)/python -m pytest -s tests/kube/faults/test_kills.py \
	  tests/kube/faults/test_deletion.py tests/kube/faults/test_several_operators.py \
	  tests/contract/test_container.py tests/e2e/test_contract.py

# Slower than make test; what fails under it is no fault of the code.
coverage: install
	rm -rf build/coverage && mkdir -p build/coverage
	-$(BIN)/python -m coverage run -m pytest -q -n $(WORKERS) -m 'not ($(THE_REST))' $(TESTS)
	$(BIN)/python -m coverage combine --quiet
	$(BIN)/python -m coverage json --quiet -o build/coverage/report.json
	$(BIN)/python tests/coverage/modules.py build/coverage/report.json

honest: install
	$(BIN)/python tests/honest/check.py --archives 5000

doctor: install
	$(BIN)/python tests/doctor/check.py

# Versions and hashes of all Python packages: make pins writes them anew, NEWEST=1 takes newer versions.
pins: install
	images/pin $(if $(NEWEST),--newest)

# Advisories about all that is pinned; needs pypi.org (or SERVICE=osv) and the npm registry itself, no mirror.
audit: install
	PATH="$(BIN):$$PATH" $(BIN)/python tests/audit/run.py $(if $(SERVICE),--service $(SERVICE))

# The CRDs and the editors' schemas from the models, and the chart's copies of them and of the catalog.
crds: install
	$(BIN)/python tools/crds.py crds
	$(BIN)/python -m slamhive.model.schemas schemas
	SLAMHIVE_UPDATE=1 $(BIN)/python -m pytest -q tests/helm -k copies_are_equal

clean:
	rm -rf $(VENV) $(VENV).making $(VENV).old $(JAVASCRIPT)/node_modules build dist .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
