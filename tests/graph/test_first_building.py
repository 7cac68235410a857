"""Own building, record and law from docs/first_building.md alone; the whole day is run by `make verify PARTS=docs`."""

import pytest
from first_building import COMMANDS, FILES, WHOLE_DAY, follow


@pytest.mark.usefixtures("domain")
def test_what_the_page_says_is_all_that_is_needed(tmp_path):
    assert set(FILES) == {"my_rig.yaml", "make_record.py", "my_law.py", "my_day.yaml"}
    assert WHOLE_DAY in COMMANDS
    printed = follow(tmp_path, without=WHOLE_DAY)
    assert len(printed) == 5
    assert "bare frame       11.3702 rad/s   0.8000 %" in printed[COMMANDS[0]]
    assert (tmp_path / "results/quake/record.png").stat().st_size > 10_000
    checked = printed[f"{WHOLE_DAY} --check"]
    assert "controlled" in checked
    assert "uncontrolled" in checked
