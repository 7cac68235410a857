#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Makes in FOLDER what stands for an Ubuntu 24.04 whose ROS 2 Jazzy is installed: FOLDER/usr, a Python of its own with
# Ubuntu's versions (requirements/ubuntu.txt), and FOLDER/opt/ros/jazzy, ROS's wheels with a setup.bash to source.
set -euo pipefail
requirements="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
folder=$(realpath -m "${1:?which folder?}")

fail() {
  echo "abrace: $*" >&2
  exit 1
}

rm -rf "$folder"
mkdir -p "$folder/usr/bin"

# An interpreter finds its library beside itself: a copy of this machine's, with an empty site-packages
python=$("${PYTHON:-python3}" -c 'import os, sys; print(os.path.realpath(sys.executable))')
read -r version library headers < <(env -u PYTHONPATH "$python" -I -c 'import sys, sysconfig
print("%d.%d" % sys.version_info[:2], sysconfig.get_path("stdlib"), sysconfig.get_path("include"))')
case $version in
  3.11 | 3.12) ;;
  *) fail "$python is Python $version; Ubuntu's NumPy 1.26.4 is for Python 3.11 or 3.12 (PYTHON=python3.12 make test-sourced)" ;;
esac
mkdir -p "$folder/usr/lib/python$version/site-packages" "$folder/usr/include"
cp "$python" "$folder/usr/bin/python$version"
ln -s "python$version" "$folder/usr/bin/python3"
ln -s "$headers" "$folder/usr/include/python$version"
for each in "$library"/* "${library%/*}"/libpython"$version"*; do
  case ${each##*/} in
    site-packages | dist-packages | EXTERNALLY-MANAGED) ;;
    libpython*) [ ! -e "$each" ] || ln -s "$each" "$folder/usr/lib/" ;;
    *) ln -s "$each" "$folder/usr/lib/python$version/" ;;
  esac
done

# Ubuntu's versions, and for what is not named there those of the lock file
"$requirements/lock_beside.sh" "$requirements/ubuntu.txt" > "$folder/lock.txt"
export PYTHONNOUSERSITE=1 PIP_ROOT_USER_ACTION=ignore
unset PYTHONPATH VIRTUAL_ENV
system=("$folder/usr/bin/python3" -m)
"${system[@]}" ensurepip > /dev/null ||
  fail "$python has no ensurepip (that of Debian and Ubuntu has none): PYTHON=python3.11 make test-sourced, with a Python of your own"
pip=("${system[@]}" pip install --quiet --disable-pip-version-check --no-warn-script-location
  -c "$folder/lock.txt" -c "$requirements/ubuntu.txt")
echo "abrace: installing Ubuntu's Python packages into $folder/usr"
"${pip[@]}" -r "$requirements/ubuntu.txt"
echo "abrace: installing ROS 2 Jazzy into $folder/opt/ros/jazzy"
ros="$folder/opt/ros/jazzy"
grep '^ros-' "$requirements/ros.txt" > "$folder/ros.txt"
"${pip[@]}" --prefix "$ros" -r "$folder/ros.txt"

# ROS's pytest plugins, which are no wheels: what loads one of them stops
packages="$ros/lib/python$version/site-packages"
mkdir "$packages/ros_pytest_plugins-1.dist-info"
printf 'Metadata-Version: 2.1\nName: ros_pytest_plugins\nVersion: 1\n' > "$packages/ros_pytest_plugins-1.dist-info/METADATA"
{
  echo '[pytest11]'
  for plugin in launch_testing launch_ros launch_pytest ament_{copyright,flake8,lint,mypy,pep257,xmllint}; do
    echo "$plugin = ros_pytest_plugins"
  done
} > "$packages/ros_pytest_plugins-1.dist-info/entry_points.txt"
echo 'raise ImportError("a pytest plugin of ROS 2 is loaded: they stop a newer pytest, and are not needed")' > "$packages/ros_pytest_plugins.py"

# The wheels find their libraries by starting Python anew; an installed ROS 2 has LD_LIBRARY_PATH
libraries=$(printf '%s:' "$ros/lib" "$packages"/ros_*.libs)
cat > "$ros/setup.bash" << END
export ROS_DISTRO=jazzy ROS_VERSION=2 ROS_PYTHON_VERSION=3 _ROS_WHEELS_BOOTSTRAP_COMPLETE=1
export AMENT_PREFIX_PATH="$ros" PYTHONPATH="$packages" PATH="$ros/bin:\$PATH" LD_LIBRARY_PATH="${libraries%:}"
END
touch "$folder/.made"
