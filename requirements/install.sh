#!/usr/bin/env bash
# Makes .venv: what abrace needs beside ROS 2 and, where no ROS 2 Jazzy is sourced, ROS 2 itself as wheels.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

fail() {
  echo "abrace: $*" >&2
  exit 1
}

python=${PYTHON:-python3}
command -v "$python" > /dev/null || fail "no $python was found; Python 3.11 or newer is needed"
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
  fail "$("$python" --version) is too old; Python 3.11 or newer is needed"
"$python" -c 'import venv, ensurepip' 2> /dev/null ||
  fail "$python has no venv module; install it (Debian and Ubuntu: python3-venv)"
"$python" -c 'import os, sys, sysconfig; sys.exit(not os.path.exists(sysconfig.get_path("include") + "/Python.h"))' ||
  fail "$python has no C headers; install them (Debian and Ubuntu: python3-dev)"
command -v "${CXX:-c++}" > /dev/null || command -v g++ > /dev/null || fail "no C++ compiler was found; install one (Debian and Ubuntu: g++)"

# the interpreter itself: `python3` may be that of the .venv that is about to be made anew
python=$("$python" -c 'import os, sys; print(os.path.realpath(sys.executable))')
stamp=.venv/.installed
rm -rf .venv
if [ -n "${ROS_DISTRO:-}" ]; then
  [ "$ROS_DISTRO" = jazzy ] || fail "ROS 2 $ROS_DISTRO is sourced; abrace needs ROS 2 Jazzy (or a shell without ROS)"
  command -v colcon > /dev/null || fail "ROS 2 Jazzy is sourced but colcon was not found (Ubuntu: python3-colcon-common-extensions)"
  echo "abrace: using the ROS 2 Jazzy of this shell; installing the other dependencies into .venv"
  # the system's NumPy and SciPy stay: its message packages are built for them
  "$python" -m venv --system-site-packages .venv
  .venv/bin/pip install --quiet --disable-pip-version-check -c requirements/system.txt -r requirements/run.txt -r requirements/develop.txt
else
  echo "abrace: installing ROS 2 Jazzy and the other dependencies into .venv (a minute or two)"
  "$python" -m venv .venv
  .venv/bin/pip install --quiet --disable-pip-version-check -c requirements/lock.txt \
    -r requirements/run.txt -r requirements/develop.txt -r requirements/ros.txt
fi
# what tests, benchmarks and scripts share is found from anywhere in this environment
echo "$PWD/tests/support" > "$(.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/abrace_tests.pth"
touch "$stamp"
