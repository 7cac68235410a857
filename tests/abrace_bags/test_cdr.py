# SPDX-License-Identifier: Apache-2.0
"""Decoding of messages: any layout gives the values that an independent serialiser wrote."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from abrace_bags.cdr import decode
from abrace_bags.definitions import MessageField, parse_fields, parse_message_type
from abrace_core.errors import AbraceError

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


def block(payloads: list[bytes]) -> list[tuple[Any, Any]]:
    """Payloads as the reader hands them over: by length, with their numbers."""
    numbered = sorted(enumerate(payloads), key=lambda item: len(item[1]))
    return [
        (np.array([n for n, _ in group]), np.array([p for _, p in group], dtype=f"V{size}"))
        for size, group in ((s, list(g)) for s, g in itertools.groupby(numbered, key=lambda item: len(item[1])))
    ]


def typestore(text: str) -> Any:
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(text, "test_msgs/msg/Outer"))
    store.register(get_types_from_msg(INNER, "test_msgs/msg/Inner"))
    return store


def decoded(text: str, payloads: list[bytes]) -> dict[str, Any]:
    definition = f"{text}\n{'=' * 80}\nMSG: test_msgs/Inner\n{INNER}"
    return decode(parse_message_type("test_msgs/msg/Outer", definition), block(payloads))


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


@settings(max_examples=120)
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


def test_equal_layouts_give_one_array_of_the_fields_type() -> None:
    store = typestore("uint8 n\nfloat32[2] v\nbool ok\nInner[] parts")
    outer, inner = store.types["test_msgs/msg/Outer"], store.types["test_msgs/msg/Inner"]
    payloads = [
        bytes(
            store.serialize_cdr(
                outer(
                    k,
                    np.array([k, 0.5], np.float32),
                    k > 1,
                    [inner(j, np.array([k, j], float), f"p{j}") for j in (1, 2)],
                ),
                "test_msgs/msg/Outer",
            )
        )
        for k in range(3)
    ]
    found = decoded("uint8 n\nfloat32[2] v\nbool ok\nInner[] parts", payloads)
    assert {name: (values.dtype.kind, values.dtype.itemsize, values.shape) for name, values in found.items()} == {
        "n": ("u", 1, (3,)),
        "v": ("f", 4, (3, 2)),
        "ok": ("b", 1, (3,)),
        "parts.flag": ("u", 1, (3, 2)),
        "parts.values": ("f", 8, (3, 2, 2)),
        "parts.label": ("U", 8, (3, 2)),
    }
    np.testing.assert_array_equal(found["ok"], [False, False, True])
    np.testing.assert_array_equal(found["parts.values"][2], [[2, 1], [2, 2]])


@pytest.mark.parametrize(
    ("payload", "complaint"),
    [
        (b"", "expected 00 01"),
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
    for payloads in ([payload], [good, payload], [good, good[:-4] + b"xyz\0", payload]):
        with pytest.raises(AbraceError, match=complaint):
            decoded("string data", payloads)


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
    assert parse_fields(text) == (
        MessageField("bounded", "float64", 0),
        MessageField("names", "string", 2),
        MessageField("thing", "pkg_msgs/msg/Thing", None),
    )


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("float64", "line 1: 'float64', expected a type and a name"),
        ("\nwstring w", "line 2: wstring fields are not supported"),
        ("Other o", "the definition of test_msgs/Other is missing"),
        ("Outer again", "test_msgs/Outer contains itself"),
    ],
)
def test_definition_that_makes_no_sense_is_refused(text: str, complaint: str) -> None:
    with pytest.raises(AbraceError, match=complaint):
        parse_message_type("test_msgs/msg/Outer", text)
