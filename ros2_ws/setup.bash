# SPDX-License-Identifier: Apache-2.0
# The environment of abrace: `source ros2_ws/setup.bash`, after `make setup`, with ROS 2 Jazzy installed or without.
_abrace_workspace="$(builtin cd "$(dirname "${BASH_SOURCE[0]}")" > /dev/null && pwd)"
_abrace_venv="$(dirname "$_abrace_workspace")/.venv"
if ! "$_abrace_workspace/../requirements/same_ros.sh"; then
  unset _abrace_workspace _abrace_venv
  return 1
fi
if [ ! -f "$_abrace_workspace/install/.built" ] || [ ! -f "$_abrace_venv/.installed" ]; then
  echo "abrace: not built yet; run 'make setup' first" >&2
  unset _abrace_workspace _abrace_venv
  return 1
fi
if [ "${VIRTUAL_ENV:-}" != "$_abrace_venv" ]; then
  . "$_abrace_venv/bin/activate"
fi
if [ -d "$_abrace_venv/share/ament_index" ]; then
  # ROS 2 as wheels: the virtual environment is the underlay
  case ":${AMENT_PREFIX_PATH:-}:" in
    *":$_abrace_venv:"*) ;;
    *)
      export AMENT_PREFIX_PATH="$_abrace_venv${AMENT_PREFIX_PATH:+:$AMENT_PREFIX_PATH}"
      export CMAKE_PREFIX_PATH="$_abrace_venv${CMAKE_PREFIX_PATH:+:$CMAKE_PREFIX_PATH}"
      ;;
  esac
fi
. "$_abrace_workspace/install/local_setup.bash"
if [ -n "${PS1:-}" ] && command -v register-python-argcomplete > /dev/null; then
  eval "$(register-python-argcomplete abrace)"
fi
unset _abrace_workspace _abrace_venv
