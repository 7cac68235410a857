# SPDX-License-Identifier: Apache-2.0
"""Own building, record and law from docs/first_building.md alone; the whole day is run by `make verify PARTS=docs`."""

import pytest
from tutorials import follow, lines

WHOLE_DAY = "abrace campaign my_day.yaml"
"""The command that takes a minute."""


@pytest.mark.usefixtures("domain")
def test_what_the_page_says_is_all_that_is_needed(tmp_path):
    given = lines("first_building")
    assert WHOLE_DAY in given
    printed = follow("first_building", tmp_path, without=[WHOLE_DAY])
    assert {path.name for path in tmp_path.glob("m*.*")} == {
        "my_rig.yaml",
        "make_record.py",
        "my_law.py",
        "my_day.yaml",
    }
    assert len(printed) == 5
    assert "bare frame       11.3702 rad/s   0.8000 %" in printed[given[0]]
    assert (tmp_path / "results/quake/record.png").stat().st_size > 10_000
    checked = printed[f"{WHOLE_DAY} --check"]
    assert "controlled" in checked
    assert "uncontrolled" in checked
