# SPDX-License-Identifier: Apache-2.0
# abrace: see README.md. Everything below `setup` runs in the workspace's environment.
SHELL := /bin/bash
.ONESHELL:
.SHELLFLAGS := -eo pipefail -c
.DEFAULT_GOAL := help
.PHONY: help setup same-ros tools demo docs reference lint test test-libraries test-sourced verify bench soak clean

ENVIRONMENT := source ros2_ws/setup.bash
# the tests start some 1500 Python processes: each would compile abrace anew
TEST_ENVIRONMENT := export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1; unset PYTHONDONTWRITEBYTECODE
# some tests wait: one more at a time than there are processors
TEST_LIBRARIES := python -m pytest --numprocesses $(shell expr $$(nproc) + 1) --dist loadscope --ignore tests/graph
PACKAGES := abrace_core abrace_bags abrace_plant abrace_sysid abrace_lqg abrace abrace_bringup
# what a build copies or generates; Python modules are linked, edits to them need no build
BUILT_FROM := $(shell find src -name package.xml -o -name 'setup.*' -o -name CMakeLists.txt -o -name '*.msg' \
  -o -name '*.action' -o -path '*/config/*.yaml' -o -path '*/launch/*.py' -o -path '*/campaigns/*.yaml' -o -path 'src/*/benchmarks/*.yaml' -o -path '*/scripts/abrace' \
  -o -path '*/scripts/make_keystore' -o -path '*/config/*.xml' \
  -o -path '*/abrace_bringup/viewer/*')

help:  ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## (.*)/\1\t\2/' |
	  while IFS=$$'\t' read -r name text; do printf '  make %-15s %s\n' "$$name" "$$text"; done

# what only tests need must not keep anyone from running: where versions are not pinned (ROS 2 sourced) it comes with the tests
setup: ros2_ws/install/.built $(if $(ROS_DISTRO),,.venv/.develop)  ## install what abrace needs into .venv and build the workspace

tools: setup .venv/.develop

same-ros:
	@requirements/same_ros.sh

.venv/.installed: requirements/install.sh $(addprefix requirements/,run.txt build.txt ros.txt lock.txt system.txt lock_beside.sh) | same-ros
	@requirements/install.sh

.venv/.develop: .venv/.installed requirements/develop.txt requirements/numpy2.txt
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

docs: tools .venv/.docs  ## the documentation as a site: docs/site/index.html
	@$(ENVIRONMENT)
	python -m sphinx --quiet --fail-on-warning --keep-going -j auto -b html docs docs/site

reference: tools  ## regenerate the pages of docs that are made from the code (docs/write_*.py)
	@$(ENVIRONMENT)
	for page in docs/write_*.py; do python "$$page"; done

lint: tools  ## ruff and mypy (its types are those of NumPy 2: not where ROS 2 is sourced)
	@$(ENVIRONMENT)
	ruff check .
	ruff format --check .
	[ -n "$(ROS_DISTRO)" ] || mypy $(foreach package,$(PACKAGES),src/$(package)/$(package)) $(wildcard src/*/scripts/*.py) $(wildcard docs/*.py) $(filter-out %.launch.py,$(filter-out %/test/%,$(wildcard examples/*/*/*.py))) benchmarks tests/support

test: lint  ## lint and all tests: the libraries' on all cores, the graph's three files at a time, what takes all cores alone
	@$(ENVIRONMENT)
	$(TEST_ENVIRONMENT)
	$(TEST_LIBRARIES)
	python -m pytest --numprocesses 3 --dist loadfile -m "not alone" tests/graph
	python -m pytest -m alone tests/graph

test-libraries: tools
	@$(ENVIRONMENT)
	$(TEST_ENVIRONMENT)
	$(TEST_LIBRARIES)

# a copy of the tracked files is set up and tested there: .venv and the workspace of this folder stay as they are
test-sourced: .sourced/.made  ## set-up, demo and tests of the libraries where ROS 2 is sourced: a machine made in .sourced
	@.ci/sourced

.sourced/.made: $(addprefix requirements/,ubuntu.sh ubuntu.txt ros.txt lock.txt lock_beside.sh)
	@requirements/ubuntu.sh .sourced

verify: tools  ## accuracy claims, measured: results/verify.json
	@$(ENVIRONMENT)
	python benchmarks/verify.py $(if $(RECORD),--record $(RECORD)) $(if $(MEASURED),--measured $(MEASURED)) $(PARTS)

bench: tools  ## speed claims, compared with other programs: results/bench.json
	@$(ENVIRONMENT)
	python benchmarks/bench.py

soak: tools  ## long runs of logger, viewer, operator's page and all nodes, some hours: results/soak.json
	@$(ENVIRONMENT)
	python benchmarks/soak.py

clean:  ## remove what was built (results, bags and whatever else a person made stay)
	@rm -rf .venv .sourced ros2_ws/build ros2_ws/install ros2_ws/log
