# SPDX-License-Identifier: Apache-2.0
"""The permissions in an SROS2 policy, read as `ros2 security create_permission` reads it."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from fnmatch import fnmatchcase

from abrace_bringup.policy import policy

KINDS = {
    "topics": ("topic", ("publish", "subscribe")),
    "services": ("service", ("reply", "request")),
    "actions": ("action", ("execute", "call")),
}
"""Lists of a profile: what is in them, and what may be allowed."""


def permissions(namespace: str = "/rig") -> dict[str, list[tuple[str, str]]]:
    """The permissions of abrace's own policy for nodes in a `namespace`, as `read_policy`."""
    return read_policy(policy(namespace))


def read_policy(content: bytes) -> dict[str, list[tuple[str, str]]]:
    """The permissions of each enclave in a policy, by its path: (`publish`, full name or pattern), and so on."""
    allowed: dict[str, list[tuple[str, str]]] = {}
    for enclave in ElementTree.fromstring(content).iterfind("enclaves/enclave"):
        rules = allowed.setdefault(enclave.attrib["path"], [])
        for profile in enclave.iterfind("profiles/profile"):
            begin = profile.attrib["ns"].rstrip("/")
            own = f"{begin}/{profile.attrib['node']}"
            for entries in profile:
                for entry in entries:
                    name = (entry.text or "").strip()
                    full = name if name[0] == "/" else own + name[1:] if name[0] == "~" else f"{begin}/{name}"
                    rules += [(act, full) for act, value in entries.attrib.items() if value == "ALLOW"]
    return allowed


def may(rules: list[tuple[str, str]], act: str, name: str) -> bool:
    """Whether an enclave with these rules may do that with the topic, service or action of this full name."""
    return any(act == allowed and fnmatchcase(name, pattern) for allowed, pattern in rules)
