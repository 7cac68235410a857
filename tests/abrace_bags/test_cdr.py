# SPDX-License-Identifier: Apache-2.0
"""Decoding of messages: any layout gives the values that an independent serialiser wrote."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from abrace_bags.cdr import decode_each
from abrace_bags.definitions import parse_message_type
from abrace_core import AbraceError

NUMBERS = {
    "bool": st.booleans(),
    "uint8": st.integers(0, 2**8 - 1),
    "int8": st.integers(-(2**7), 2**7 - 1),
    "int16": st.integers(-(2**15), 2**15 - 1),
    "uint32": st.integers(0, 2**32 - 1),
    "int64": st.integers(-(2**63), 2**63 - 1),
    "uint64": st.integers(0, 2**64 - 1),
    "float32": st.floats(width=32, allow_nan=False),
    "float64": st.floats(allow_nan=False),
}
DTYPES = {"bool": np.bool_, **{name: np.dtype(name).type for name in NUMBERS if name != "bool"}}
TEXT = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=6)
INNER = "uint8 flag\nfloat64[] values\nstring label\n"


def typestore(text: str) -> Any:
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(text, "test_msgs/msg/Outer"))
    store.register(get_types_from_msg(INNER, "test_msgs/msg/Inner"))
    return store


def decoded(text: str, payloads: list[bytes]) -> dict[str, Any]:
    definition = f"{text}\n{'=' * 80}\nMSG: test_msgs/Inner\n{INNER}"
    found = decode_each(parse_message_type("test_msgs/msg/Outer", definition), payloads)
    assert found.misfit == ""
    return found.fields


def plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else value


def deep(value: Any) -> Any:
    """Nested lists of an array, also of objects."""
    value = plain(value)
    return [deep(one) for one in value] if isinstance(value, list) else value


@st.composite
def outer_messages(draw: st.DrawFn) -> tuple[str, list[dict[str, Any]]]:
    """A message text and the values of some messages of that type."""
    kinds = draw(
        st.lists(st.sampled_from(["one", "array", "sequence", "text", "texts", "inner", "inners"]), max_size=6)
    )
    lines, values = [], {}
    inner = st.tuples(NUMBERS["uint8"], st.lists(NUMBERS["float64"], max_size=2), TEXT)
    for number, kind in enumerate(kinds):
        name = f"field{number}"
        type_name = draw(st.sampled_from(sorted(NUMBERS)))
        if kind == "one":
            lines.append(f"{type_name} {name}")
            values[name] = NUMBERS[type_name]
        elif kind in ("array", "sequence"):
            lines.append(f"{type_name}[{3 if kind == 'array' else ''}] {name}")
            sizes = {"min_size": 3, "max_size": 3} if kind == "array" else {"max_size": 2}
            values[name] = st.lists(NUMBERS[type_name], **sizes).map(lambda v, t=type_name: np.array(v, DTYPES[t]))
        elif kind in ("text", "texts"):
            lines.append(f"string{'[]' if kind == 'texts' else ''} {name}")
            values[name] = TEXT if kind == "text" else st.lists(TEXT, max_size=2)
        else:
            lines.append(f"Inner{'[]' if kind == 'inners' else ''} {name}")
            values[name] = inner if kind == "inner" else st.lists(inner, max_size=2)
    messages = draw(st.lists(st.fixed_dictionaries(values), min_size=1, max_size=5))
    return "\n".join(lines), messages


@settings(max_examples=60)
@given(outer_messages())
def test_values_are_those_that_rosbags_serialised(case: tuple[str, list[dict[str, Any]]]) -> None:
    text, messages = case
    store = typestore(text)
    outer, inner = store.types["test_msgs/msg/Outer"], store.types["test_msgs/msg/Inner"]

    def built(value: Any) -> Any:
        if isinstance(value, tuple):
            return inner(value[0], np.array(value[1], float), value[2])
        return (
            [built(one) for one in value] if isinstance(value, list) and value and value[0] != str(value[0]) else value
        )

    payloads = [
        bytes(store.serialize_cdr(outer(**{k: built(v) for k, v in message.items()}), "test_msgs/msg/Outer"))
        for message in messages
    ]
    found = decoded(text, payloads)
    for name in messages[0] if messages else ():
        for number, message in enumerate(messages):
            value = message[name]
            if name in found:
                assert deep(found[name][number]) == deep(value)
                continue
            for place, part in enumerate(("flag", "values", "label")):
                expected = value[place] if isinstance(value, tuple) else [one[place] for one in value]
                assert deep(found[f"{name}.{part}"][number]) == expected


def test_equal_lengths_with_other_layouts_are_not_confused() -> None:
    store = typestore("float64[] a\nfloat64[] b")
    outer = store.types["test_msgs/msg/Outer"]
    shapes = [(3, 2), (2, 3), (3, 2), (2, 3)]
    payloads = [
        bytes(store.serialize_cdr(outer(np.arange(m) + 1.0, -np.arange(n) - 1.0), "test_msgs/msg/Outer"))
        for m, n in shapes
    ]
    assert len(set(map(len, payloads))) == 1
    found = decoded("float64[] a\nfloat64[] b", payloads)
    assert found["a"].dtype == object
    assert [len(a) for a in found["a"]] == [3, 2, 3, 2]
    np.testing.assert_array_equal(found["b"][1], [-1.0, -2.0, -3.0])


@pytest.mark.parametrize(
    ("payload", "complaint"),
    [
        (b"", "has less than 4 bytes"),
        (b"\0\0\0\0\0\0\0\3abc\0", "begins with 00 00, expected 00 01"),
        (b"\0\1\0\0\4\0\0\0ab", "too few"),
        (b"\0\1\0\0\xff\xff\xff\xffabc\0", "too few"),
        (b"\0\1\0\0\4\0\0\0abcd", "does not end with a zero"),
        (b"\0\1\0\0\3\0\0\0\xff\xfe\0", "not UTF-8"),
        (b"\0\1\0\0\4\0\0\0abc\0more", "has 16 bytes, expected 12"),
    ],
)
def test_message_that_does_not_fit_its_definition_is_refused(payload: bytes, complaint: str) -> None:
    good = b"\0\1\0\0\4\0\0\0abc\0"
    message_type = parse_message_type("std_msgs/msg/String", "string data")
    for payloads in ([payload], [good, payload]):
        with pytest.raises(AbraceError, match=complaint):
            decode_each(message_type, payloads)
    found = decode_each(message_type, [good, payload, good[:-4] + b"xyz\0"])
    assert (found.fields["data"].tolist(), found.fits.tolist()) == (["abc", "xyz"], [0, 2])
    assert found.misfit.startswith("message 1: ")
    assert complaint in found.misfit


def test_padding_behind_the_last_value_is_passed_over() -> None:
    assert list(decoded("string data", [b"\0\1\0\0\2\0\0\0a\0\x55\x66", b"\0\1\0\0\0\0\0\0"])["data"]) == ["a", ""]


def test_comments_constants_defaults_and_bounds_are_no_fields() -> None:
    text = """
    # a comment
    int32 LIMIT=3
    string NAME = "a # b"
    float64[<=4] bounded 3
    string<=5[2] names  # two
    pkg_msgs/msg/Thing thing
    """
    found = parse_message_type("pkg_msgs/msg/Outer", f"{text}\n{'=' * 80}\r\nMSG: pkg_msgs/Thing\r\nint8 x\r\n")
    assert found.names(found.name) == ["bounded", "names", "thing.x"]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("float64", "line 1: 'float64', expected a type and a name"),
        ("\nwstring w", "field w is a wstring, which is not supported"),
        ("Other o", "the definition of test_msgs/msg/Other is missing"),
        ("Outer again", "test_msgs/msg/Outer contains itself"),
    ],
)
def test_definition_that_makes_no_sense_is_refused(text: str, complaint: str) -> None:
    with pytest.raises(AbraceError, match=complaint):
        parse_message_type("test_msgs/msg/Outer", text)
