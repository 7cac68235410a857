# abrace: see README.md. Everything below `setup` runs in the workspace's environment.
SHELL := /bin/bash
.ONESHELL:
.SHELLFLAGS := -eo pipefail -c
.DEFAULT_GOAL := help
.PHONY: help setup demo test lint verify bench soak clean

ENVIRONMENT := source ros2_ws/setup.bash
PACKAGES := abrace_core abrace_bags abrace_plant abrace_sysid abrace_lqg abrace abrace_bringup
# what a build copies or generates; Python modules are linked, edits to them need no build
BUILT_FROM := $(shell find src -name package.xml -o -name 'setup.*' -o -name CMakeLists.txt -o -name '*.msg' \
  -o -name '*.action' -o -path '*/config/*.yaml' -o -path '*/launch/*.py' -o -path '*/campaigns/*.yaml' -o -path '*/scripts/abrace')

help:  ## this list
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## /  make \1\t/'

setup: ros2_ws/install/.built  ## install what abrace needs into .venv and build the workspace

.venv/.installed: requirements/install.sh requirements/run.txt requirements/develop.txt requirements/ros.txt requirements/lock.txt requirements/system.txt
	@requirements/install.sh

ros2_ws/install/.built: .venv/.installed $(BUILT_FROM)
	@source .venv/bin/activate
	if [ -d .venv/share/ament_index ]; then
	  export AMENT_PREFIX_PATH="$$PWD/.venv" CMAKE_PREFIX_PATH="$$PWD/.venv"
	fi
	cd ros2_ws
	echo "abrace: building the workspace"
	colcon --log-level error build --symlink-install --event-handlers console_cohesion- console_start_end- desktop_notification-
	touch install/.built

demo: setup  ## the paper, live: tests, model, controller, earthquake, table (results/demo)
	@$(ENVIRONMENT)
	abrace demo

lint: setup  ## ruff and mypy
	@$(ENVIRONMENT)
	ruff check .
	ruff format --check .
	mypy $(foreach package,$(PACKAGES),src/$(package)/$(package)) $(wildcard src/*/scripts/*.py) docs/write_nodes.py benchmarks tests/support

test: lint  ## lint and all tests: those of the libraries on all cores, then those of the graph one by one
	@$(ENVIRONMENT)
	export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
	python -m pytest --numprocesses auto --dist loadscope --ignore tests/graph
	python -m pytest tests/graph

verify: setup  ## accuracy claims, measured: results/verify.json
	@$(ENVIRONMENT)
	python benchmarks/verify.py $(if $(RECORD),--record $(RECORD))

bench: setup  ## speed claims beside their peers: results/bench.json
	@$(ENVIRONMENT)
	python benchmarks/bench.py

soak: setup  ## long runs of the logger, ends of nodes and launches, 20 minutes: results/soak.json
	@$(ENVIRONMENT)
	python benchmarks/soak.py

clean:  ## remove what was built and made (not bags)
	@rm -rf .venv ros2_ws/build ros2_ws/install ros2_ws/log results
