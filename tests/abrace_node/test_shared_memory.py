# SPDX-License-Identifier: Apache-2.0
import fcntl
import os

from abrace_node.shared_memory import FOLDER, remove_stale_segments
from abrace_node.transport import profile


def test_shared_memory_is_removed_where_no_node_holds_it_any_more(tmp_path):
    names = {kind: f"fastrtps_{number:016x}" for number, kind in enumerate(("killed", "living", "being made"))}
    for kind, name in names.items():
        for ending in ("", "_el"):
            (tmp_path / f"{name}{ending}").write_text("")
        if kind != "being made":
            os.utime(tmp_path / f"{name}_el", (1.0, 1.0))
    (tmp_path / "fastrtps_port7000_el").write_text("")
    (tmp_path / "other").write_text("")
    with (tmp_path / f"{names['living']}_el").open("rb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        remove_stale_segments(tmp_path)
    left = {path.name for path in tmp_path.iterdir()}
    kept = {f"{names[kind]}{ending}" for kind in ("living", "being made") for ending in ("", "_el")}
    assert left == kept | {"fastrtps_port7000_el", "other"}


def test_every_node_that_starts_removes_what_killed_ones_have_left():
    name = f"fastrtps_{os.getpid():016x}"
    for ending in ("", "_el"):
        (FOLDER / f"{name}{ending}").write_text("")
    os.utime(FOLDER / f"{name}_el", (1.0, 1.0))
    with profile(streams=True):
        assert not list(FOLDER.glob(f"{name}*"))
