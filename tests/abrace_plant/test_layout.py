# SPDX-License-Identifier: Apache-2.0
"""Layouts of packets: where each field stands, and what a packet may hold."""

import math
import struct
import zlib

import pytest
import yaml
from udp_target import CHANNELS, CONFIG

from abrace_core import AbraceError
from abrace_plant.devices.layout import Layout, Malformed, Packet, read_layout

HEAD = """
- {field: constant, type: uint8, value: 9}
- {field: arm, type: uint32}
- {field: wanted, type: uint16}
"""
"""What a command must have, beside its counter and signals."""


def packet(
    fields: str, signals: tuple[str, ...] = (), alignment: int = 1, byte_order: str = "little", kind: str = "command"
) -> Packet:
    both = {"sample": yaml.safe_load(fields), "command": yaml.safe_load(fields)}
    content = {"byte_order": byte_order, "alignment": alignment, **both}
    return Packet(Layout.model_validate(content), kind, signals)


SIMULINKS_EXAMPLE = """
- {field: a1, type: uint8}
- {field: counter, type: uint32}
- {field: a2, type: float32}
- {field: a3, type: int16}
- {field: f, type: float64}
"""
"""The example of Byte Packing's documentation: with an alignment of 4 its signals begin at bytes 0, 4, 8, 12 and 16."""


@pytest.mark.parametrize(
    ("alignment", "form", "length"),
    [
        (1, "<BIfhdBIH", 26),
        (2, "<BxIfhdBxIH", 28),
        (4, "<BxxxIfhxxdBxxxIH", 34),
        (8, "<B7xI4xf4xh6xdB7xI4xH", 58),
    ],
)
def test_fields_stand_where_simulinks_byte_packing_puts_them(alignment, form, length):
    layout = packet(SIMULINKS_EXAMPLE + HEAD.lstrip(), ("a1", "a2", "a3", "f"), alignment)
    packed = layout.encode([7, 0.5, -300, math.pi], 99, arm=3, state=2)
    assert packed == struct.pack(form, 7, 99, 0.5, -300, math.pi, 9, 3, 2)
    assert len(packed) == layout.length == length
    assert layout.decode(packed).signals == (7, 0.5, -300, math.pi)


def test_the_values_of_a_vector_are_not_aligned_one_by_one():
    layout = packet(
        f"- {{field: counter, type: uint8}}\n- {{field: [x1, x2, x3], type: int16}}{HEAD}", ("x1", "x2", "x3"), 4
    )
    assert layout.encode([1, 2, 3], 5, arm=6) == struct.pack("<BxxxhhhxxBxxxIH", 5, 1, 2, 3, 9, 6, 0)


@pytest.mark.parametrize(("byte_order", "sign"), [("little", "<"), ("big", ">")])
def test_a_whole_sample_in_either_byte_order(byte_order, sign):
    fields = """
    - {field: constant, type: uint16, value: 0xabcd}
    - {field: counter, type: uint32}
    - {field: applied_counter, type: uint16}
    - {field: time, type: float64, unit: ms}
    - {field: state, type: uint8}
    - {field: causes, type: uint16}
    - {field: arm, type: uint32}
    - {field: unused, type: uint8, count: 3}
    - {field: [f, w], type: float32}
    - {field: crc, type: uint32}
    """
    layout = packet(fields, ("f", "w"), byte_order=byte_order, kind="sample")
    body = struct.pack(f"{sign}HIHdBHI3xff", 0xABCD, 2**32 - 1, 7, 1.5, 1, 0x8001, 2**32 - 2, 0.25, -8.0)
    packed = layout.encode([0.25, -8.0], -1, 1_500_000, 2**32 - 2, 1, 0x8001, 65536 + 7)
    assert packed == body + struct.pack(f"{sign}I", zlib.crc32(body))
    assert layout.decode(packed) == (2**32 - 1, (0.25, -8.0), 1_500_000, 2**32 - 2, 1, 0x8001, 7)


@pytest.mark.parametrize("kind", ["sample", "command"])
def test_a_state_that_there_is_not_is_malformed(kind):
    names = (*CHANNELS, *EXTRA) if kind == "sample" else ("U", "w")
    layout = Packet(read_layout(CONFIG / "device_parts/udp_layout.yaml"), kind, names)
    assert layout.decode(layout.encode([1.0] * len(names), 1, state=2)).state == 2
    with pytest.raises(Malformed, match=r"^wrong_state$"):
        layout.decode(layout.encode([1.0] * len(names), 1, state=3))


def test_signals_are_given_in_their_own_order_whatever_the_packets():
    fields = f"- {{field: w, type: float64}}\n- {{field: counter, type: uint8}}{HEAD}- {{field: x1, type: float64}}"
    layout = packet(fields, ("x1", "w"))
    packed = layout.encode([1.0, 2.0], 3)
    assert packed == struct.pack("<dBBIHd", 2.0, 3, 9, 0, 0, 1.0)
    assert layout.decode(packed).signals == (1.0, 2.0)


def test_whole_numbers_are_rounded_and_end_where_their_type_ends():
    layout = packet(
        f"- {{field: counter, type: uint8}}\n- {{field: [x1, x2, x3], type: int16}}{HEAD}", ("x1", "x2", "x3")
    )
    assert layout.decode(layout.encode([1.6, 1e9, -1e9], 0)).signals == (2, 32767, -32768)


EXTRA = ("applied_U", "applied_w", "table_displacement")
COUNT = len(CHANNELS) + len(EXTRA)


def ours() -> Packet:
    return Packet(read_layout(CONFIG / "device_parts/udp_layout.yaml"), "sample", (*CHANNELS, *EXTRA))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("channel", range(COUNT))
def test_a_packet_with_a_value_that_is_not_finite_is_malformed(channel, value):
    layout, values = ours(), [1.0] * COUNT
    values[channel] = value
    with pytest.raises(Malformed, match=r"^not_finite$"):
        layout.decode(layout.encode(values, 1))


def test_infinities_of_either_sign_do_not_cancel():
    layout = ours()
    with pytest.raises(Malformed, match=r"^not_finite$"):
        layout.decode(layout.encode([math.inf, -math.inf, *[0.0] * (COUNT - 2)], 1))


def test_every_single_inverted_bit_is_found():
    layout = ours()
    good = layout.encode([1.0] * COUNT, 1, 2, 3, 1, 64, 5)
    for bit in range(8 * len(good)):
        changed = bytearray(good)
        changed[bit // 8] ^= 1 << bit % 8
        with pytest.raises(Malformed, match=r"^wrong_crc$"):
            layout.decode(bytes(changed))


@pytest.mark.parametrize("length", [0, 1, 143, 145, 1500])
def test_a_packet_of_another_length_is_malformed(length):
    with pytest.raises(Malformed, match=r"^wrong_length$"):
        ours().decode(bytes(length))


def test_a_packet_of_another_layout_of_the_same_length_is_malformed():
    layout = ours()
    good = layout.encode([1.0] * COUNT, 1)
    with pytest.raises(Malformed, match=r"^wrong_constant$"):
        layout.decode(layout.sign(b"\0" + good[1:]))


def test_a_time_beyond_all_clocks_is_malformed():
    fields = f"- {{field: counter, type: uint8}}{HEAD}- {{field: time, type: float64, unit: s}}"
    layout = packet(fields + "\n- {field: w, type: float64}", ("w",))
    for time in (1e300, -1e300, 9.3e9):
        with pytest.raises(Malformed, match=r"^wrong_time$"):
            layout.decode(struct.pack("<BBIHdd", 1, 9, 0, 0, time, 0.0))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (
            "[{field: w, type: float64}]",
            "sample: no field constant, counter, time, state, causes, arm, applied_counter,",
        ),
        (
            "[{field: counter, type: uint8}]",
            "arm, applied_counter, w, expected constant, counter, time, state, causes,",
        ),
        (
            "[{field: a9, type: float64}]",
            "sample.0.field: 'a9', expected one of counter, time, arm, wanted, state, causes",
        ),
        ("[{field: [w, counter], type: uint8}]", "sample.0.field: 'counter', expected one of"),
        ("[{field: w, type: float64}, {field: w, type: float64}]", "sample.1.field: 'w' appears twice"),
        ("[{field: crc, type: uint32}, {field: w, type: float64}]", "crc, expected at the end of the packet"),
        ("[{field: crc, type: uint16}]", "sample.0.type: uint16 for crc, expected uint32"),
        ("[{field: counter, type: float64}]", "sample.0.type: float64 for counter, expected uint8"),
        ("[{field: time, type: uint32}]", "sample.0.type: uint32 for time, expected int64, uint64, float64"),
        ("[{field: constant, type: uint8}]", "sample.0.value: key is missing"),
        ("[{field: constant, type: uint8, value: 256}]", "sample.0.value: 256, expected 0 to 255 (uint8)"),
        ("[{field: w, type: uint8, value: 1}]", "sample.0.value: 1, expected for the field constant alone"),
        ("[{field: w, type: uint8, count: 3}]", "sample.0.count: 3, expected for the field unused alone"),
        ("[{field: w, type: uint8, unit: ms}]", "sample.0.unit: ms, expected for the field time alone"),
        ("[{field: counter, type: uint8, clock: own}]", "sample.0.clock: own, expected for the field time alone"),
        ("[{field: wanted, type: uint8}]", "sample.0.field: 'wanted', expected in a command"),
        ("[{field: arm, type: uint16}]", "sample.0.type: uint16 for arm, expected uint32"),
    ],
)
def test_a_layout_that_cannot_be_is_refused_by_its_field(fields, message):
    with pytest.raises(AbraceError) as refused:
        packet(fields, ("w",), kind="sample")
    assert message in str(refused.value)
