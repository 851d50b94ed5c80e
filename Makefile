# make demo and make test do all the set-up that they need; the second time they skip it.
PYTHON ?= python3
VENV := .venv
OUT ?= runs/demo-$(shell date +%Y%m%d-%H%M%S)
SEED ?= 1
BUILD := $(VENV)/bin/colcon --log-level error build --event-handlers console_direct- summary-
CMAKE_ARGS := --cmake-args -DPython3_EXECUTABLE=$(CURDIR)/$(VENV)/bin/python \
  -DCMAKE_BUILD_TYPE=Release -DBUILD_TESTING=OFF \
  -DCMAKE_PROJECT_INCLUDE=$(CURDIR)/tools/drop_missing_includes.cmake
INTERFACES := $(shell find src/humanopts_interfaces -type f)
PACKAGES := $(shell find src -type f -not -path 'src/humanopts_interfaces/*' \
  -not -path '*/test/*' -not -name '*.pyc')
# What mypy checks: the packages, and what is built on them.
PURE := $(shell find src -name '*.py' -path '*/humanopts_*/humanopts_*') \
  $(wildcard experiments/*.py benchmarks/*.py)
CHECKED := src experiments benchmarks tests tools examples
WITH_ROS := root=$(CURDIR); . tools/environment.sh; ROS_PYTHON_CHECK_FIELDS=1
# Two processes, each with a file of tests at a time: while one waits for its graph, one computes.
SIDE_BY_SIDE := OMP_NUM_THREADS=1 $(VENV)/bin/python -m pytest \
  -n 2 --dist loadfile --no-loadscope-reorder
SHELL := /bin/bash

export AMENT_PREFIX_PATH := $(CURDIR)/$(VENV)
export CMAKE_PREFIX_PATH := $(CURDIR)/$(VENV)
unexport PYTHONPATH PYTHONDONTWRITEBYTECODE

.PHONY: help setup demo test test-quick test-slow lint docs format lock clean

help:
	@echo 'make demo    teach a simulated agent two options for Taxi, plan, drive, report (OUT=, SEED=)'
	@echo 'make test    run the tests, two at a time (ARGS=): first those that need no graph, which'
	@echo '             make test-quick runs alone; make test-slow runs the long ones'
	@echo 'make lint    ruff, mypy --strict, package.xml checks'
	@echo 'make docs    build the documentation as a site, build/site/index.html'
	@echo 'make setup   only the set-up that the others do when it is needed'
	@echo 'make format  reformat the Python code'
	@echo 'make lock    resolve requirements.in into requirements.lock again'
	@echo 'make clean   remove everything that make made'

setup: build/.packages

$(VENV)/.locked: requirements.lock
	@tools/check_prerequisites.sh $(PYTHON)
	@echo 'Installing the locked packages into $(VENV) ...'
	@rm -rf $(VENV) && $(PYTHON) -m venv $(VENV)
	@$(VENV)/bin/pip install --quiet --disable-pip-version-check --require-hashes \
	  -r requirements.lock 2> >(grep -v -e '^WARNING: Location' -e DEPRECATION >&2)
	@touch $@

build/.interfaces: $(VENV)/.locked $(INTERFACES)
	@echo 'Building the ROS interfaces (one to three minutes) ...'
	@PATH="$(CURDIR)/$(VENV)/bin:$$PATH" $(BUILD) --packages-select humanopts_interfaces \
	  $(CMAKE_ARGS) 2> >(grep -v 'local_setup' >&2)
	@touch $@

# The types of messages, for mypy: a misspelt field is an error.
build/.stubs: build/.interfaces tools/make_stubs.py
	@$(VENV)/bin/python tools/make_stubs.py build/stubs $(VENV)/share src
	@touch $@

build/.packages: build/.interfaces $(PACKAGES)
	@echo 'Building the Python packages ...'
	@rm -rf install/humanopts_{ros,env,learner,teach} build/humanopts_{ros,env,learner,teach}
	@PATH="$(CURDIR)/$(VENV)/bin:$$PATH" $(BUILD) \
	  --packages-select humanopts_ros humanopts_env humanopts_learner humanopts_teach \
	  2> >(grep -v 'local_setup' >&2) > build/packages.log || { cat build/packages.log; exit 1; }
	@printf '%s\n' $(CURDIR)/install/humanopts_*/lib/python3.*/site-packages > build/humanopts.pth
	@mv build/humanopts.pth $$(echo $(VENV)/lib/python3.*/site-packages)/  # for people's own scripts
	@touch $@

demo: setup
	@./humanopts demo --domain taxi --out $(OUT) --seed $(SEED)

test: setup
	@$(WITH_ROS) $(SIDE_BY_SIDE) -m 'not slow' $(ARGS)

test-quick: setup
	@$(WITH_ROS) $(SIDE_BY_SIDE) -m 'not slow and not live' $(ARGS)

test-slow: setup
	@$(WITH_ROS) $(VENV)/bin/python -m pytest -m slow $(ARGS)

lint: setup build/.stubs
	@$(VENV)/bin/ruff check $(CHECKED)
	@$(VENV)/bin/ruff format --check --quiet $(CHECKED)
	@$(VENV)/bin/mypy $(PURE)
	@$(VENV)/bin/python tools/check_packages.py

docs: $(VENV)/.locked
	@NO_MKDOCS_2_WARNING=1 $(VENV)/bin/mkdocs build --strict 2> >(grep -v '^INFO' >&2)
	@echo 'The documentation is build/site/index.html'

format: setup
	@$(VENV)/bin/ruff check --fix --quiet $(CHECKED)
	@$(VENV)/bin/ruff format $(CHECKED)

lock:
	@$(PYTHON) -m venv build/lock && build/lock/bin/pip install --quiet uv
	@build/lock/bin/uv pip compile --universal --python-version 3.11 --generate-hashes \
	  --no-emit-index-url --no-header --quiet requirements.in -o requirements.lock

clean:
	@rm -rf $(VENV) build install log .mypy_cache .ruff_cache .pytest_cache .hypothesis
	@find $(CHECKED) -name __pycache__ -type d -prune -exec rm -rf {} +
