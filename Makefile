# make demo and make test do the necessary set-up, and skip it the next time.
PYTHON ?= python3
VENV := .venv
CACHE := $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/humanopts
OUT ?= runs/demo-$(shell date +%Y%m%d-%H%M%S)
SEED ?= 1
ROUNDS ?= 10
LIMIT ?= 7200
SECONDS ?= 600
FAULTS ?= 100
STEP := @tools/step.sh
TWO_STEPS := $(MAKE) --no-print-directory --silent --jobs 2
PAGE := -name '*.md' -o -name '*.rst'
INTERFACES := $(shell find src/humanopts_interfaces -type f -not \( $(PAGE) \))
BUILD_INTERFACES := tools/build_interfaces.sh tools/wheels.cmake tools/generate_interfaces.py
ROBOT_INTERFACES := humanopts_rover_interfaces tf2_msgs
ROBOTS := $(shell find examples/humanopts_rover examples/humanopts_gripper -name '*.py')
PACKAGES := $(shell find src -type f -not -path 'src/humanopts_interfaces/*' \
  -not -path '*/test/*' -not -name '*.pyc' -not \( $(PAGE) \))
# Checked by mypy: the packages, and the code built on them.
PURE := $(shell find src -name '*.py' -path '*/humanopts_*/humanopts_*') \
  $(wildcard experiments/*.py benchmarks/*.py) \
  $(wildcard examples/*/humanopts_*/simulation.py) examples/humanopts_rover/humanopts_rover/driving.py
CHECKED := conftest.py src experiments benchmarks tests tools examples
WITH_ROS := root=$(CURDIR); . tools/environment.sh; ROS_PYTHON_CHECK_FIELDS=1
# Four processes, each with one test file at a time: some compute while others wait for graphs.
SIDE_BY_SIDE := OMP_NUM_THREADS=1 $(VENV)/bin/python -m pytest \
  -n 4 --dist loadfile --no-loadscope-reorder
# Tests to run with the oldest packages; make test-floor only imports everything else.
FLOOR := src/humanopts_env src/humanopts_learner $(foreach name,evaluation export study_tables table1, \
  $(wildcard src/humanopts_teach/test/test_$(name)*.py))
COMPILE := build/lock/bin/uv pip compile --universal --python-version 3.11 --generate-hashes \
  --no-emit-index-url --no-header --quiet
SHELL := /bin/bash

# Drop the variables of another ROS that the shell has sourced, and the user's colcon settings.
unexport PYTHONDONTWRITEBYTECODE COLCON_DEFAULTS_FILE
unexport $(shell cat src/humanopts_ros/humanopts_ros/foreign_variables.txt)
export COLCON_HOME := $(CURDIR)/build/colcon

.PHONY: help setup checked wheels release-check robots demo test test-quick test-floor test-kilted test-whole test-slow test-browser test-hosts test-stress soak faults lint docs screens format lock clean

help:
	@echo 'make demo    let a simulated teacher teach two options for Taxi; plan, play, report (OUT=, SEED=)'
	@echo 'make test    run the tests, four at a time (ARGS=); those without a graph come first'
	@echo 'make test-quick  run the quick tests of pure code; make test-slow  those that take minutes'
	@echo 'make test-whole  run tests of whole commands: the demo of Pac-Man, studies, dying nodes'
	@echo 'make test-floor  run tests of pure code with the oldest supported packages'
	@echo 'make test-kilted  run the tests over the graph with ROS 2 Kilted, in build/kilted'
	@echo 'make test-browser  run the tests that teach in Chromium'
	@echo 'make test-hosts  run the tests over two hosts, in namespaces of this machine'
	@echo 'make test-stress  run the graph tests ten times, with busy cores and late discovery'
	@echo '             (ROUNDS=, SEED=, LIMIT= in seconds, ARGS= for files)'
	@echo 'make soak    run a long lesson with random faults and garbage (SECONDS=, SEED=)'
	@echo 'make faults  kill, stop, blind and cut off what drives the simulated rover (FAULTS=, SEED=)'
	@echo 'make lint    run ruff and mypy --strict; check rosdep keys and pages of the packages'
	@echo 'make docs    build the documentation as a site, build/site/index.html'
	@echo 'make screens  record the pictures of the terminal in docs/images, with real keys'
	@echo 'make robots  build the simulated robots of the examples: a rover and a gripper'
	@echo 'make wheels  build wheels and sdists into dist/; make release-check installs and tries them (ARGS=--quick)'
	@echo 'make setup   do only the set-up, which the other targets do when needed'
	@echo 'make format  reformat the Python code'
	@echo 'make lock    resolve requirements*.in into requirements*.lock'
	@echo 'make clean   remove everything that make created'

setup:
	@$(TWO_STEPS) build/.packages $(VENV)/.compiled

# ROS and the build tools. The other packages are installed while the interfaces compile.
$(VENV)/.build-locked: requirements-build.lock
	@tools/check_prerequisites.sh $(PYTHON)
	@rm -rf $(VENV) && $(PYTHON) -m venv $(VENV)
	$(STEP) 'Installing ROS and the build tools' tools/install_packages.sh $(VENV) $<
	@touch $@

$(VENV)/.locked: requirements.lock $(VENV)/.build-locked
	$(STEP) 'Installing the packages needed to run' tools/install_packages.sh $(VENV) $<
	@touch $@

# Additional packages for tests, checks and documentation.
$(VENV)/.test-locked: requirements-test.lock $(VENV)/.locked
	$(STEP) 'Installing the packages of the tests' tools/install_packages.sh $(VENV) $<
	@touch $@

# The oldest supported packages, in a folder that comes first on the path.
build/floor/.locked: requirements-floor.lock $(VENV)/.locked tools/install_packages.sh
	@rm -rf $(@D)
	$(STEP) 'Installing the oldest supported packages' tools/install_packages.sh $(VENV) $< $(@D)
	@touch $@

build/.interfaces: $(VENV)/.build-locked $(INTERFACES) $(BUILD_INTERFACES)
	$(STEP) 'Building the ROS interfaces' tools/build_interfaces.sh $(VENV) src/humanopts_interfaces install
	@touch $@

# Type stubs of the messages, so that mypy reports misspelt fields.
build/.stubs: build/.interfaces tools/make_stubs.py
	@$(VENV)/bin/python tools/make_stubs.py build/stubs $(VENV)/share src
	@touch $@

build/.packages: build/.interfaces $(VENV)/.locked $(PACKAGES) tools/build_packages.sh
	$(STEP) 'Building the Python packages' tools/build_packages.sh $(VENV)
	@touch $@

# The simulated robots of the examples, with their own interfaces.
.SECONDEXPANSION:
build/robots/.interfaces-%: $$(shell find examples/$$* -type f) $(VENV)/.build-locked $(BUILD_INTERFACES)
	$(STEP) 'Building $*' tools/build_interfaces.sh $(VENV) examples/$* build/robots
	@touch $@

build/robots/.built: $(ROBOT_INTERFACES:%=build/robots/.interfaces-%) $(ROBOTS) tools/build_robots.sh
	$(STEP) 'Building the simulated robots' tools/build_robots.sh $(VENV)
	@touch $@

# Runs while the interfaces are built; a third of that build uses only one core.
$(VENV)/.compiled: $(VENV)/.locked tools/compile_imports.py
	$(STEP) 'Compiling the modules that the packages import' $(SHELL) -c \
	  '$(WITH_ROS); $(VENV)/bin/python tools/compile_imports.py'
	@touch $@

# Prerequisites of tests and checks. setuptools loads installed packages, so ours are built last.
checked:
	@$(TWO_STEPS) $(VENV)/.test-locked build/.stubs
	@$(TWO_STEPS) build/.packages build/robots/.built

wheels: setup
	@$(VENV)/bin/python tools/build_wheels.py dist

release-check: wheels
	@$(VENV)/bin/python tools/release_check.py dist $(ARGS)

robots: setup
	@$(TWO_STEPS) build/robots/.built

demo: setup
	@./humanopts demo taxi --out $(OUT) --seed $(SEED)

test: checked $(VENV)/.compiled
	@$(WITH_ROS) $(SIDE_BY_SIDE) -m 'not slow and not whole and not chromium and not hosts' $(ARGS)

test-quick: checked
	@$(WITH_ROS) $(SIDE_BY_SIDE) -m 'not slow and not live and not heavy' $(or $(ARGS),src)

# Test a copy of this repository with ROS 2 Kilted in place of Jazzy.
test-kilted:
	@$(PYTHON) tools/kilted.py build/kilted
	@$(MAKE) --no-print-directory -C build/kilted test ARGS='$(or $(ARGS),tests)'

# Leave out tests that take long but compute little.
test-floor: checked build/floor/.locked
	@$(WITH_ROS); export PYTHONPATH=$(CURDIR)/build/floor:$$PYTHONPATH; \
	  $(VENV)/bin/python tools/check_floor.py requirements-floor.lock && \
	  OMP_NUM_THREADS=1 $(VENV)/bin/python -m pytest -q -n 2 --hypothesis-profile few \
	  -m 'not slow and not live and not heavy' $(or $(ARGS),$(FLOOR))

test-whole: checked
	@$(WITH_ROS) $(SIDE_BY_SIDE) -m 'whole and not slow' $(or $(ARGS),tests)

test-slow: checked
	@$(WITH_ROS) $(VENV)/bin/python -m pytest -m slow $(ARGS)

test-browser: checked
	@for each in chromium chromedriver nginx; do PATH=$$PATH:/usr/sbin command -v $$each > /dev/null || { \
	  echo 'make test-browser needs: sudo apt install chromium chromium-driver nginx-light' >&2; exit 1; }; done
	@$(WITH_ROS) $(VENV)/bin/python -m pytest -n 2 --dist loadfile -m chromium $(or $(ARGS),$(wildcard tests/test_browser_*.py))

test-hosts: checked
	@for each in unshare nsenter ip; do command -v $$each > /dev/null || { \
	  echo "make test-hosts needs $$each: sudo apt install util-linux iproute2" >&2; exit 1; }; done
	@$(WITH_ROS) $(VENV)/bin/python -m pytest -m hosts $(or $(ARGS),tests/test_two_hosts.py tests/test_robot_faults.py)

test-stress: checked
	@$(WITH_ROS) $(VENV)/bin/python tools/stress_tests.py \
	  --rounds $(ROUNDS) --seed $(SEED) --limit $(LIMIT) $(ARGS)

soak: checked
	@$(WITH_ROS); PYTHONPATH="$$PYTHONPATH:tests" $(VENV)/bin/python -m graph_support.soak \
	  --seconds $(SECONDS) --seed $(SEED) $(ARGS)

faults: checked
	@$(WITH_ROS); export PYTHONPATH="$$PYTHONPATH:$(CURDIR)/tests"; \
	  $(VENV)/bin/python -m graph_support.faults --faults $(FAULTS) --seed $(SEED) $(ARGS)

lint: checked
	@$(VENV)/bin/ruff check $(CHECKED)
	@$(VENV)/bin/ruff format --check --quiet $(CHECKED)
	@$(VENV)/bin/mypy $(PURE)
	@$(VENV)/bin/python tools/check_packages.py

screens: checked
	@$(WITH_ROS); PYTHONPATH="$$PYTHONPATH:$(CURDIR)/tests" $(VENV)/bin/python tools/record_screens.py docs/images

docs: $(VENV)/.test-locked
	@NO_MKDOCS_2_WARNING=1 $(VENV)/bin/mkdocs build --strict 2> >(grep -v '^INFO' >&2)
	@echo 'The documentation is build/site/index.html'

format: checked
	@$(VENV)/bin/ruff check --fix --quiet $(CHECKED)
	@$(VENV)/bin/ruff format $(CHECKED)

lock:
	@$(PYTHON) -m venv build/lock && build/lock/bin/pip install --quiet uv
	@$(COMPILE) requirements.in -o requirements.lock
	@$(COMPILE) requirements-build.in -c requirements.lock -o requirements-build.lock
	@$(COMPILE) requirements-test.in -c requirements.lock -o requirements-test.lock
	@$(COMPILE) requirements-floor.in -o requirements-floor.lock
	@$(COMPILE) requirements-kilted.in -o requirements-kilted.lock

clean:
	@rm -rf $(VENV) build install log .mypy_cache .ruff_cache .pytest_cache .hypothesis
	@find $(CHECKED) -name __pycache__ -type d -prune -exec rm -rf {} +
	@echo 'Built interfaces stay in $(CACHE) for the next clone; rm -r removes them.'
