# SPDX-License-Identifier: Apache-2.0
"""Own building, record, law and day from docs/first_building.md alone."""

import json

import pytest
from tutorials import follow, lines

WHOLE_DAY = "abrace campaign my_day.yaml"


@pytest.mark.usefixtures("domain")
def test_what_the_page_says_is_all_that_is_needed(tmp_path):
    given = lines("first_building")
    assert WHOLE_DAY in given
    printed = follow("first_building", tmp_path)
    assert {path.name for path in tmp_path.glob("m*.*")} == {
        "my_rig.yaml",
        "make_record.py",
        "my_law.py",
        "my_day.yaml",
    }
    assert len(printed) == 6
    assert "bare frame       11.3702 rad/s   0.8000 %" in printed[given[0]]
    assert (tmp_path / "results/quake/record.png").stat().st_size > 10_000
    checked = printed[f"{WHOLE_DAY} --check"]
    assert "controlled" in checked
    assert "uncontrolled" in checked
    # the rig gives no interlocks: their limits follow from its numbers
    assert "interlocks" not in (tmp_path / "my_rig.yaml").read_text()
    found = json.loads((tmp_path / "results/my_day/comparison/comparison.json").read_text())
    assert found["measured"]["x5"]["rms"] < 0.5 * found["uncontrolled"]["x5"]["rms"]
    assert (tmp_path / "results/my_day/report.html").is_file()
