#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Makes .venv: what abrace needs beside ROS 2 and, where no ROS 2 Jazzy is sourced, ROS 2 itself as wheels.
# `install.sh tests` adds what tests and checks need, `install.sh docs` what `make docs` does, `install.sh records` what
# reads further formats of records.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

fail() {
  echo "abrace: $*" >&2
  exit 1
}

runs() {  # a line of Python, without the packages of the shell
  env -u PYTHONPATH "$python" -c "$1" > /dev/null 2>&1
}

install() {  # versions as in lock.txt; the system's NumPy and SciPy stay where ROS 2 is sourced: its packages are built for them
  local versions=(-c requirements/lock.txt)
  if [ -n "${ROS_DISTRO:-}" ]; then
    requirements/lock_beside.sh requirements/system.txt > .venv/lock.txt
    versions=(-c .venv/lock.txt -c requirements/system.txt)
  fi
  .venv/bin/python -m pip install --quiet --disable-pip-version-check "${versions[@]}" "$@"
}

if [ "${1:-}" = tests ]; then
  echo "abrace: installing what tests need into .venv"
  if [ -n "${ROS_DISTRO:-}" ]; then
    install -r requirements/develop.txt -r requirements/records.txt
  else
    install -r requirements/develop.txt -r requirements/numpy2.txt -r requirements/records.txt
  fi
  # what tests, benchmarks and scripts share is found from anywhere in this environment
  echo "$PWD/tests/support" > "$(.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/abrace_tests.pth"
  touch .venv/.develop
  exit
fi

if [ "${1:-}" = records ]; then
  echo "abrace: installing the readers of further formats of records into .venv"
  install -r requirements/records.txt
  exit
fi

if [ "${1:-}" = docs ]; then
  echo "abrace: installing what the documentation site needs into .venv"
  install -r requirements/docs.txt
  touch .venv/.docs
  exit
fi

python=${PYTHON:-python3}
command -v "$python" > /dev/null || fail "no $python was found; Python 3.11 or newer is needed"
runs 'pass' || fail "$python does not run; Python 3.11 or newer is needed"
runs 'import sys; sys.exit(sys.version_info < (3, 11))' ||
  fail "$("$python" --version 2>&1) is too old; Python 3.11 or newer is needed"
runs 'import venv, ensurepip' || fail "$python has no venv module; install it (Debian and Ubuntu: python3-venv)"
for module in ssl ctypes zlib bz2 lzma; do
  runs "import $module" || fail "$python was built without its module $module; use another Python (PYTHON=/usr/bin/python3 make setup)"
done
runs 'import os, sys, sysconfig; sys.exit(not os.path.exists(sysconfig.get_path("include") + "/Python.h"))' ||
  fail "$python has no C headers; install them (Debian and Ubuntu: python3-dev)"
command -v "${CXX:-c++}" > /dev/null || command -v g++ > /dev/null || fail "no C++ compiler was found; install one (Debian and Ubuntu: g++)"

# the interpreter itself: `python3` may be that of the .venv that is about to be made anew
python=$("$python" -c 'import os, sys; print(os.path.realpath(sys.executable))')
if [ -n "${ROS_DISTRO:-}" ]; then
  [ "$ROS_DISTRO" = jazzy ] || fail "ROS 2 $ROS_DISTRO is sourced; abrace needs ROS 2 Jazzy (or a shell without ROS)"
  "$python" -c 'import numpy, rclpy' 2> /dev/null ||
    fail "$python cannot import the sourced ROS 2's rclpy; use the Python that it is for (PYTHON=/usr/bin/python3 make setup)"
  command -v cmake > /dev/null || fail "no cmake was found; install it (Debian and Ubuntu: cmake)"
else
  [ "$(uname -sm)" = "Linux x86_64" ] ||
    fail "ROS 2's wheels are for Linux on x86_64, this is $(uname -sm); install ROS 2 Jazzy and source it"
fi

# what was built with another .venv is of no use to this one
rm -rf .venv ros2_ws/build ros2_ws/install ros2_ws/log
if [ -n "${ROS_DISTRO:-}" ]; then
  echo "abrace: using the ROS 2 Jazzy of this shell; installing the other dependencies into .venv"
  "$python" -m venv --system-site-packages .venv
  install -r requirements/run.txt -r requirements/build.txt
  # the system's colcon would write the system's Python into what it builds
  [ -e .venv/bin/colcon ] || printf '#!/bin/sh\nexec "%s" -m colcon "$@"\n' "$PWD/.venv/bin/python" > .venv/bin/colcon
  chmod +x .venv/bin/colcon
else
  echo "abrace: installing ROS 2 Jazzy and the other dependencies into .venv (a minute or two)"
  "$python" -m venv .venv
  install -r requirements/run.txt -r requirements/build.txt -r requirements/ros.txt
fi
echo "${ROS_DISTRO:-}" > .venv/.installed
