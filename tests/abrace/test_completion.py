# SPDX-License-Identifier: Apache-2.0
"""The Tab key behind `abrace`, as an interactive bash presses it."""

import subprocess
from pathlib import Path

SETUP = Path(__file__).parents[2] / "ros2_ws/setup.bash"
PRESS = """
source "$1"; shift
for typed; do
COMP_LINE="abrace $typed"; COMP_POINT=${#COMP_LINE}; COMP_TYPE=9
read -ra COMP_WORDS <<< "$COMP_LINE"
[[ "$COMP_LINE" != *" " ]] || COMP_WORDS+=("")
COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
function=$(complete -p abrace | sed -E 's/.*-F ([^ ]+).*/\\1/')
$function abrace "${COMP_WORDS[-1]}" "${COMP_WORDS[-2]}"
echo ${COMPREPLY[@]}
done
"""


TYPED = {
    "cam": {"campaign"},
    "run abrace_pl": {"abrace_plant"},
    "run abrace_plant gro": {"ground_motion"},
    "campaign five_": {"five_controllers", "five_storeys"},
    "campaign demo --from com": {"command_noise", "comparison"},
    "benchmark sac_": {"sac_la_3", "sac_la_9", "sac_la_20"},
    "bag csv B --out": {"--output"},
}


def test_a_shell_completes_commands_packages_executables_campaigns_steps_and_options(tmp_path):
    command = ["bash", "--norc", "-ic", PRESS, "bash", SETUP, *TYPED]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
    lines = ended.stdout.splitlines()
    assert {typed: set(line.split()) for typed, line in zip(TYPED, lines, strict=True)} == TYPED, ended.stderr
