# SPDX-License-Identifier: Apache-2.0
# abrace: see README.md. Everything below `setup` runs in the workspace's environment.
SHELL := /bin/bash
.ONESHELL:
.SHELLFLAGS := -eo pipefail -c
.DEFAULT_GOAL := help
.PHONY: help setup records same-ros tools demo docs reference lint test test-computing test-pip test-sourced verify bench soak clean

ENVIRONMENT := source ros2_ws/setup.bash
RUN_STAGES = $${PYTHON:-python3} tests/runner $(if $(filter-out 0,$(STRICT)),--strict)
TYPES = $(if $(ROS_DISTRO),true,mypy $(foreach package,$(PACKAGES),src/$(package)/$(package)) $(wildcard docs/*.py) \
  $(filter-out %.launch.py,$(wildcard examples/*/*/*.py)) benchmarks tests/support tests/runner)
PACKAGES := abrace_core abrace_node abrace_bags abrace_plant abrace_sysid abrace_lqg abrace_studies abrace abrace_bringup
# what a build copies or generates; Python modules are linked, edits to them need no build
BUILT_FROM := $(shell find src -name package.xml -o -name 'setup.*' -o -name CMakeLists.txt -o -name '*.msg' \
  -o -name '*.action' -o -path '*/config/*.yaml' -o -path '*/launch/*.py' -o -path '*/campaigns/*.yaml' -o -path 'src/*/benchmarks/*.yaml' -o -path 'src/*/frames/*.yaml' -o -path '*/scripts/abrace' \
  -o -path '*/config/*.xml' \
  -o -path '*/abrace_bringup/viewer/*')

help:  ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## (.*)/\1\t\2/' |
	  while IFS=$$'\t' read -r name text; do printf '  make %-15s %s\n' "$$name" "$$text"; done

# what only tests need must not keep anyone from running: where versions are not pinned (ROS 2 sourced) it comes with the tests
setup: ros2_ws/install/.built $(if $(ROS_DISTRO),,.venv/.develop)  ## install what abrace needs into .venv and build the workspace

tools: setup .venv/.develop

records: .venv/.installed  ## readers of SAC, miniSEED, Kinemetrics, UFF 58, MATLAB 7.3
	@requirements/install.sh records

same-ros:
	@requirements/same_ros.sh

.venv/.installed: requirements/install.sh $(addprefix requirements/,run.txt build.txt ros.txt lock.txt system.txt lock_beside.sh) | same-ros
	@requirements/install.sh

.venv/.develop: .venv/.installed $(addprefix requirements/,develop.txt numpy2.txt records.txt)
	@requirements/install.sh tests

.venv/.docs: .venv/.develop requirements/docs.txt
	@requirements/install.sh docs

ros2_ws/install/.built: .venv/.installed $(BUILT_FROM) | same-ros
	@source .venv/bin/activate
	if [ -d .venv/share/ament_index ]; then
	  export AMENT_PREFIX_PATH="$$PWD/.venv" CMAKE_PREFIX_PATH="$$PWD/.venv"
	fi
	cd ros2_ws
	echo "abrace: building the workspace"
	# links to files that an older version had
	[ ! -d build ] || find build install -xtype l -delete
	python -m colcon --log-level error build --symlink-install --event-handlers console_cohesion- console_start_end- desktop_notification-
	touch install/.built

demo: setup  ## the paper, live: tests, model, controller, earthquake, table (results/demo)
	@$(ENVIRONMENT)
	abrace demo

docs: tools .venv/.docs  ## the documentation as a site: docs/site/index.html; `man docs/site/man/abrace.1`
	@$(ENVIRONMENT)
	python -m sphinx --quiet --fail-on-warning --keep-going -j auto -b html docs docs/site
	python -m sphinx --quiet -b man -d docs/site/.doctrees docs docs/site/man

reference: tools  ## regenerate the pages of docs that are made from the code (docs/write_*.py)
	@$(ENVIRONMENT)
	for page in docs/write_*.py; do python "$$page"; done

lint: tools  ## ruff and mypy (its types are those of NumPy 2: not where ROS 2 is sourced)
	@$(ENVIRONMENT)
	failed=0
	ruff check --output-format concise . || failed=1
	ruff format --check . || failed=1
	$(TYPES) || failed=1
	exit $$failed

test: tools  ## lint and all tests; STAGES="graph alone": some of them; STRICT=1: an unsteady test is a failure
	@$(RUN_STAGES) $(or $(STAGES),lint libraries graph alone)

test-computing: tools  ## the tests that compute, by the kernels for an old processor
	@$(RUN_STAGES) old_processor

test-pip:  ## `pip install .` with PYTHON in an empty environment, and the first lines of docs/python.md there
	@rm -rf .pip
	$${PYTHON:-python3} -m venv .pip
	.pip/bin/pip install --quiet . $(WITH)
	# a build or an abrace.egg-info in the checkout would be taken for the package abrace of the workspace
	left=$$(find . src src/* -maxdepth 1 \( -name build -o -name '*.egg-info' -o -name '*.dist-info' \))
	[ -z "$$left" ] || { echo "abrace: pip install . left in the checkout: $$left" >&2; exit 1; }
	cd .pip
	env -u PYTHONPATH bin/abrace --version
	env -u PYTHONPATH bin/python -c "import abrace; run = abrace.simulate('ncree_three_storey', 'el_centro', \
	  controller=abrace.design('ncree_three_storey', 'lqg3'), peak_acceleration=0.98, duration=12.0); print(run)"

# a copy of the tracked files is set up and tested there: .venv and the workspace of this folder stay as they are
test-sourced: .sourced/.made  ## set-up, demo, own packages and some tests where ROS 2 is sourced: a machine made in .sourced
	@$(RUN_STAGES) sourced versions

.sourced/.made: $(addprefix requirements/,ubuntu.sh ubuntu.txt ros.txt lock.txt lock_beside.sh)
	@requirements/ubuntu.sh .sourced

verify: tools  ## accuracy claims, measured: results/verify.json
	@$(ENVIRONMENT)
	python benchmarks/verify.py $(if $(RECORD),--record $(RECORD)) $(if $(MEASURED),--measured $(MEASURED)) \
	  $(if $(ROBOT_ARM),--robot-arm $(ROBOT_ARM)) $(PARTS)

bench: tools  ## speed claims, compared with other programs: results/bench.json
	@$(ENVIRONMENT)
	python benchmarks/bench.py $(PARTS)

soak: tools  ## long runs of logger and operator's page, 75 minutes: results/soak.json
	@$(ENVIRONMENT)
	python benchmarks/soak.py $(PARTS)

clean:  ## remove what was built (results, bags and whatever else a person made stay)
	@rm -rf .venv .sourced .pip build ros2_ws/build ros2_ws/install ros2_ws/log
