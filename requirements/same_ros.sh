#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Whether the ROS 2 of this shell is that of .venv: neither serves the other.
stamp="$(dirname "${BASH_SOURCE[0]}")/../.venv/.installed"
[ -f "$stamp" ] || exit 0
ros=$(cat "$stamp")
[ "$ros" != "${ROS_DISTRO:-}" ] || exit 0
if [ -n "$ros" ]; then
  echo "abrace: built with the installed ROS 2 ${ros^}, which is not sourced in this shell: source /opt/ros/$ros/setup.bash first" >&2
else
  echo "abrace: built with ROS 2 as wheels, but ROS 2 ${ROS_DISTRO^} is sourced in this shell: use a shell without it, or build on it with 'make clean setup'" >&2
fi
exit 1
