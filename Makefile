# The front door for people with a clone: 'make help' lists what there is.

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.SUFFIXES:

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
LFNAV := $(BIN)/lfnav
VENV_PYTHON := $(BIN)/python

# The C++ core: whatever needs the installation compiles anew what has changed of it.
CORE := CMakeLists.txt $(wildcard native/*.cpp native/*.hpp)

# The first interpreter that is new enough; 'make install PYTHON=/path/to/python' overrides.
NEW_ENOUGH := import sys; sys.exit(sys.version_info < (3, 11))
PYTHON = $(shell for name in python3 python3.13 python3.12 python3.11 python; do \
	"$$name" -c '$(NEW_ENOUGH)' >/dev/null 2>&1 && { echo "$$name"; break; }; done)

DATA := sample_data
DEMO := out/demo
DEMO_SFM := out/demo-sfm
DEMO_DOCK := out/demo-dock
# Between the two left doors, facing the call button: x and y in metres, heading in degrees.
DOCK := -1.15,-1.65,90
DEMO_ODOMETRY := odometry.txt
SEED := 0
# Distribution of ROS 2 for test-ros: jazzy or kilted.
ROS := jazzy
# One process a processor, which keeps to it (tests/conftest.py); files stay whole for what their tests share.
TEST_WORKERS = -n $(shell nproc 2>/dev/null || getconf _NPROCESSORS_ONLN) --dist loadfile

.PHONY: help install demo demo-sfm demo-dock test test-slow test-lowest test-sanitized test-ros lint lint-style lint-types lint-core format wheel bench bench-against docs-settings clean

help:
	@echo "make install      a virtual environment in $(VENV) with lfnav in it"
	@echo "make demo         the whole chain on a lobby with three equal doors -> $(DEMO)/report/report.html"
	@echo "make demo-sfm     the same on a workshop, mapped by structure from motion -> $(DEMO_SFM)/report/report.html"
	@echo "make demo-dock    docks a robot in the lobby whose camera images are path-traced -> $(DEMO_DOCK)/report/report.html"
	@echo "make experiments  many seeds and settings -> out/experiments/*/table.md; makes only what is missing"
	@echo "make test         the test suite; 'make test-slow' runs the slow tests"
	@echo "make test-ros     the nodes with the real rclpy, from wheels, in .venv-jazzy; ROS=kilted"
	@echo "make lint         ruff, mypy, clang-format and clang-tidy"
	@echo "make wheel        a wheel for this machine -> dist/, tried in an empty environment"
	@echo "make bench        measures particles, frames, views, starting, memory, the GPU"
	@echo "make bench-against REVISION=...  particles, views, alignments, depth maps beside an older revision"
	@echo "make docs-settings  docs/settings.md from the definitions of the settings"
	@echo "make clean        removes out/ and caches; $(VENV) stays"

# ---------------------------------------------------------------------------- installation

install: $(STAMP)

# An environment without pip is the rest of an attempt that failed; it is made anew.
$(STAMP): pyproject.toml $(CORE)
	@test -n "$(PYTHON)" || { echo "lfnav needs Python 3.11 or newer; install it or say make PYTHON=/path/to/python" >&2; exit 1; }
	@$(VENV_PYTHON) -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV)
	.ci/install $(VENV) $(if $(filter pyproject.toml,$?),,--core-only)
	@touch $@

# ---------------------------------------------------------------------------- demonstrations

demo: $(STAMP)
	@echo "== 1/6 Where was the camera when each map photo was taken? (from the wheels' odometry)"
	$(LFNAV) reconstruct $(DATA)/elevators/map -o $(DEMO)/map --method odometry --overwrite
	@echo "== 2/6 The scene model: photos, their poses, and the plane of the wall, found by comparing photos"
	$(LFNAV) model $(DEMO)/map -o $(DEMO)/scene.h5 --geometry plane --overwrite
	@echo "== 3/6 Where is the robot? A particle filter, told neither place nor heading at the start"
	$(LFNAV) localize $(DEMO)/scene.h5 $(DATA)/elevators/test -o $(DEMO)/run.h5 --seed $(SEED) \
		--odometry $(DATA)/elevators/test/$(DEMO_ODOMETRY) --overwrite
	@echo "== 4/6 How far off was it? (against the ground truth, which no stage above has used)"
	$(LFNAV) evaluate $(DEMO)/run.h5
	@echo "== 5/6 The report"
	$(LFNAV) report $(DEMO)/run.h5 -o $(DEMO)/report --overwrite
	@echo "== 6/6 Docking: a simulated robot, told neither place nor heading, drives to the call button"
	$(LFNAV) dock $(DEMO)/scene.h5 --robot model:$(DEMO)/scene.h5 --goal $(DOCK) --true-start 0.5,-3.5,120 \
		-o $(DEMO)/dock.h5 --seed $(SEED) --overwrite
	$(LFNAV) report $(DEMO)/dock.h5 -o $(DEMO)/dock-report --overwrite
	@echo "== Done. Open $(CURDIR)/$(DEMO)/report/report.html in a browser, and $(DEMO)/dock-report/report.html beside it."

demo-dock: $(STAMP)
	$(BIN)/python -m pip install --quiet --no-build-isolation --editable '.[dev,sim]'
	@echo "== 1/4 Where was the camera when each map photo was taken? (from the photos and the odometry of a robot on a floor)"
	$(LFNAV) reconstruct $(DATA)/elevators/map -o $(DEMO_DOCK)/map --method sfm --planar --overwrite
	@echo "== 2/4 The scene model, with depth maps computed from the photos (a minute or two)"
	$(LFNAV) model $(DEMO_DOCK)/map -o $(DEMO_DOCK)/scene.h5 --geometry depth --overwrite
	@echo "== 3/4 Docking: a robot whose camera images are path-traced (a second or two of processor time each)"
	$(LFNAV) dock $(DEMO_DOCK)/scene.h5 --robot sim:$(DATA)/elevators/scene/scene.xml --goal $(DOCK) \
		--true-start 0.5,-3.5,120 -o $(DEMO_DOCK)/dock.h5 --seed $(SEED) --overwrite
	@echo "== 4/4 The report"
	$(LFNAV) report $(DEMO_DOCK)/dock.h5 -o $(DEMO_DOCK)/report --overwrite
	@echo "== Done. Open $(CURDIR)/$(DEMO_DOCK)/report/report.html in a browser."

demo-sfm: $(STAMP)
	@echo "== 1/5 Where was the camera when each map photo was taken? (from the photos; takes minutes)"
	$(LFNAV) reconstruct $(DATA)/workshop/map -o $(DEMO_SFM)/map --method sfm --overwrite
	@echo "== 2/5 The scene model: photos, their poses, and the plane that fits the sparse points best"
	$(LFNAV) model $(DEMO_SFM)/map -o $(DEMO_SFM)/scene.h5 --geometry plane --overwrite
	@echo "== 3/5 Where is the robot? A particle filter, told neither place nor heading at the start"
	$(LFNAV) localize $(DEMO_SFM)/scene.h5 $(DATA)/workshop/test -o $(DEMO_SFM)/run.h5 --seed $(SEED) \
		--odometry $(DATA)/workshop/test/$(DEMO_ODOMETRY) --overwrite
	@echo "== 4/5 How far off was it? (a workshop is no plane: one plane is the coarsest surface there is)"
	$(LFNAV) evaluate $(DEMO_SFM)/run.h5
	@echo "== 5/5 The report"
	$(LFNAV) report $(DEMO_SFM)/run.h5 -o $(DEMO_SFM)/report --overwrite
	@echo "== Done. Open $(CURDIR)/$(DEMO_SFM)/report/report.html in a browser."

include experiments/experiments.mk

# ---------------------------------------------------------------------------- development

test: $(STAMP)
	$(VENV_PYTHON) -m pytest $(TEST_WORKERS)

test-slow: $(STAMP)
	$(VENV_PYTHON) -m pytest -m slow

# The lower bounds in pyproject.toml are the versions in this file; here they are tried.
test-lowest:
	$(PYTHON) -m venv --clear .venv-lowest
	.ci/install .venv-lowest --constraint .ci/lowest-versions.txt
	.venv-lowest/bin/python -m pytest $(TEST_WORKERS)

# The nodes with the real rclpy, from wheels for tests; one suite at a time, for nodes hear each other.
test-ros: $(STAMP)
	.ci/test-ros $(VENV_PYTHON) .venv-$(ROS) $(ROS)

# The C++ core with the compiler's sanitizers, in the tests that reach it.
test-sanitized: $(STAMP)
	.ci/test-sanitized $(VENV) $(TEST_WORKERS)

lint: lint-style lint-types lint-core

lint-style: $(STAMP)
	$(VENV_PYTHON) -m ruff check .
	$(VENV_PYTHON) -m ruff format --check .
	$(BIN)/clang-format --dry-run --Werror native/*.cpp native/*.hpp

lint-types: $(STAMP)
	$(VENV_PYTHON) -m mypy --strict

lint-core: $(STAMP)
	.ci/clang-tidy $(VENV)

format: $(STAMP)
	$(VENV_PYTHON) -m ruff check --fix .
	$(VENV_PYTHON) -m ruff format .
	$(BIN)/clang-format -i native/*.cpp native/*.hpp

wheel:
	@test -n "$(PYTHON)" || { echo "lfnav needs Python 3.11 or newer; install it or say make PYTHON=/path/to/python" >&2; exit 1; }
	.ci/wheel $(PYTHON)

bench: $(STAMP)
	$(VENV_PYTHON) -m benchmarks.run

# Beside an older revision, by default the last one with numba: make bench-against REVISION=v1.2
bench-against: $(STAMP)
	$(VENV_PYTHON) -m benchmarks.against $(REVISION)

# All settings, their names, ranges and defaults, from where they are defined.
docs-settings: $(STAMP)
	$(VENV_PYTHON) -m pipelines.dock.settings_page docs/settings.md

clean:
	rm -rf out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find lfnav lfnav_cli pipelines tests benchmarks experiments -name __pycache__ -type d -prune -exec rm -rf {} +
