# SPDX-License-Identifier: Apache-2.0
"""Through how many objects a message passes from a live recording to the file."""

from __future__ import annotations

import sys
import threading
from typing import TYPE_CHECKING, Any

from abrace_bags import BagWriter
from abrace_bags.recording import Recording

if TYPE_CHECKING:
    from pathlib import Path

DEFINITION = "std_msgs/Header header\nuint64 sequence\n"


def test_a_recorded_message_passes_at_most_four_objects(tmp_path: Path) -> None:
    """Counted are the classes of which a method is called with the message's bytes, in any thread."""
    payload = bytes(1000)
    passed: list[str] = []

    def profile(frame: Any, event: str, _: object) -> None:
        arguments = frame.f_code.co_varnames[: frame.f_code.co_argcount]
        if event == "call" and "self" in arguments and any(frame.f_locals[name] is payload for name in arguments):
            passed.append(type(frame.f_locals["self"]).__name__)

    threading.setprofile(profile)
    sys.setprofile(profile)
    try:
        recording = Recording(BagWriter(tmp_path / "bag", {}), 10.0)
        topic = recording.add_topic("/response", "test_msgs/msg/Numbered", DEFINITION, "")
        recording.write(topic, payload, 1, 1)
        recording.close()
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    assert {"Recording", "BagWriter"} <= set(passed)
    assert len(set(passed)) <= 4, passed
