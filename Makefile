# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0

PYTHON ?= python3
ARGS ?=
# The oldest and the newest installed Python, for `make homes`.
HOMES ?= $(PYTHON)
VENV := .venv
# What the demo needs is a third of all; where all is installed, that is used.
DEMO_VENV := $(if $(wildcard $(VENV)/.stamp),$(VENV),.venv-demo)
COLCON_VENV := .venv-colcon
DOCS_VENV := .venv-docs
# Tests of running nodes mostly wait, hence more processes than a small machine has cores. Tests of
# one file share the nodes that they have started.
SPREAD := --numprocesses 3 --dist loadfile --no-loadscope-reorder

# The ROS wheels set these two in every process they start; a child that is started with another
# virtual environment's Python would load the wrong libraries.
unexport LD_LIBRARY_PATH
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE
# Tests start hundreds of processes; none of them should compile the package again.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help demo test test-fast processors check walk faults venv homes newest wheels docs clean

help:  ## List the commands
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /\1\t/' | expand -t 12

demo: $(DEMO_VENV)/.stamp  ## Run the paper's case study (ARGS="--case 2"); first installs 0.5 GB in a minute
	$(DEMO_VENV)/bin/sphere_nmpc demo $(ARGS)
	@echo "next: . $(DEMO_VENV)/bin/activate, and then that command, or sphere_nmpc --help"
	@[ $(DEMO_VENV) = $(VENV) ] || \
		echo "maps, the plant with contact, identify and benchmark need the rest, 350 MB: make venv"

test: check $(COLCON_VENV)/.stamp  ## Lint, type check and run every test, in about 6 minutes (ARGS="-k name")
	@echo "all tests take about six minutes on two idle cores, longer on busy ones"
	$(VENV)/bin/python -m pytest $(SPREAD) $(ARGS)

test-fast: $(VENV)/.stamp  ## Run the tests that are not marked slow
	$(VENV)/bin/python -m pytest $(SPREAD) -m "not slow" $(ARGS)

processors: $(VENV)/.stamp  ## Run the tests of computations with the kernels of other processors
	for kernel in Prescott Haswell Zen SkylakeX; do OPENBLAS_CORETYPE=$$kernel \
		$(VENV)/bin/python -m pytest $(SPREAD) test/unit test/loops $(ARGS) || exit 1; done

check: $(VENV)/.stamp  ## Lint and type check
	$(VENV)/bin/ruff check .
	$(VENV)/bin/mypy

walk: $(VENV)/.stamp  ## Count the calls of a pose, a tick, a goal and a map (ARGS="--profile pose")
	@$(VENV)/bin/python bench/walk.py $(ARGS)

faults: $(VENV)/.stamp  ## Inject faults into running nodes (ARGS="--quick --json out/faults.json")
	$(VENV)/bin/python test/campaign/faults.py $(ARGS)

venv: $(VENV)/.stamp  ## Install the package and everything it can use into .venv

homes:  ## Install from scratch with pip and colcon, and test that (HOMES="python3.10 python3.13")
	.ci/homes .venv-homes $(HOMES)

newest:  ## Test with the newest version of each dependency
	$(PYTHON) -m venv --clear .venv-newest
	.venv-newest/bin/python -m pip install --quiet -e ".[all]" setuptools
	.venv-newest/bin/python -m pip list
	.venv-newest/bin/python -m pytest $(SPREAD) -m "not slow" $(ARGS)

wheels:  ## Build and check wheels and source distribution in dist/ (HOMES="python3.10 python3.13")
	.ci/wheels .venv-wheels $(HOMES)
	mkdir -p dist && cp .venv-wheels/dist/* dist

docs: $(DOCS_VENV)/.stamp  ## Build the documents as pages in build/pages; a broken link is an error
	$(DOCS_VENV)/bin/sphinx-build -W --keep-going -c docs . build/pages

clean:  ## Remove the virtual environments and all that was built
	rm -rf $(VENV) .venv-demo $(COLCON_VENV) .venv-homes .venv-newest .venv-wheels $(DOCS_VENV) .pixi build dist install log *.egg-info \
		examples/build examples/*.egg-info
	rm -rf .hypothesis .mypy_cache .pytest_cache .ruff_cache sphere_nmpc/solver/native/*.so

# Where standard output is a terminal pip shows its progress, elsewhere a log would be full of it.
PIP = @[ -t 1 ] && quiet= || quiet=--quiet; $(@D)/bin/python -m pip install $$quiet --no-deps

define new_venv
@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || { \
	echo "sphere_nmpc needs Python 3.10 or later: make $(MAKECMDGOALS) PYTHON=/path/to/python3" >&2; exit 1; }
@$(PYTHON) -c 'import ensurepip, venv' || { \
	echo "$(PYTHON) lacks the venv module (on Debian and Ubuntu: apt install python3-venv)" >&2; exit 1; }
$(PYTHON) -m venv $(@D)
endef

$(VENV)/.stamp: PINS := requirements/lock.txt
$(VENV)/.stamp: WHAT := ROS 2, CasADi, SciPy, MuJoCo, viser, test tools ...
$(VENV)/.stamp: COST := 350 MB to download, 1.3 GB on disk, a minute and the download
.venv-demo/.stamp: PINS := requirements/demo.txt
.venv-demo/.stamp: WHAT := ROS 2, NumPy, Matplotlib, viser ..., what the demo needs
.venv-demo/.stamp: COST := 100 MB to download, 0.5 GB on disk, half a minute and the download

# The last ones are what the solver is compiled from.
$(VENV)/.stamp .venv-demo/.stamp: setup.py package.xml $(wildcard requirements/*.txt) \
		$(wildcard sphere_nmpc/solver/native/*.[ch] sphere_nmpc/solver/native/*.inc)
	$(new_venv)
	@echo "$(@D), 1 of 2: $(WHAT), once:"
	@echo "  $(COST)"
	$(PIP) --use-pep517 -r $(PINS)
	@echo "$(@D), 2 of 2: this package, whose solver is compiled: half a minute"
	$(PIP) --no-build-isolation -e .
	@touch $@

# colcon needs an older setuptools than the rest, hence a virtual environment of its own.
$(COLCON_VENV)/.stamp: requirements/colcon.txt
	$(new_venv)
	@echo "$(@D): colcon and what its builds need, for tests, once: 70 MB on disk, half a minute"
	$(PIP) --use-pep517 -r requirements/colcon.txt
	@touch $@

$(DOCS_VENV)/.stamp: requirements/docs.txt
	$(new_venv)
	$(PIP) -r requirements/docs.txt
	@touch $@
