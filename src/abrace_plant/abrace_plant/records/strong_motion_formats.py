# SPDX-License-Identifier: Apache-2.0
"""Readers of the formats of strong-motion networks: K-NET and KiK-net, CSMIP volume 2, COSMOS V2.

- `.ew`, `.ns`, `.ud`, also followed by 1 (borehole) or 2 (surface): K-NET and KiK-net ASCII. A header of 17 lines,
  then counts of the digitiser; the scale factor in the header, `3920(gal)/6182761`, makes them gal (cm/s^2). The counts
  include the sensor's offset, which remains in the acceleration.
- `.v2`, `.v2c`: CSMIP and COSMOS. A line with the number of points and the unit precedes each block of numbers,
  which are Fortran's: in columns of a stated width (CSMIP's older files state none: 8F10), so that neighbours may
  touch. Velocity, displacement and the rest of the headers are ignored. COSMOS gives the period in its real header:
  value 62 [ms], that of the series, before value 34 [s], that of the recorder. A unit code (COSMOS table 2) must agree
  with the unit in words.

Where a file holds several channels, the channel is the station's number of one (`Sta Chn`, else `Chan`).

References: NIED, "About K-NET ASCII format"; COSMOS Strong Motion Data Format, version 1.20 (2001); CSMIP's files from
1979 to 2021.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from abrace_plant.records.reading import UNITS, Reading, checked_reading, unit_named

if TYPE_CHECKING:
    from abrace_plant.records.reading import RecordText

KNET_ENDINGS = tuple(f".{direction}{sensor}" for direction in ("ew", "ns", "ud") for sensor in ("", "1", "2"))
V2_ENDINGS = (".v2", ".v2c")

_KNET_SCALE = re.compile(r"([\d.]+)\s*\(\s*(\w+)\s*\)\s*/\s*([\d.]+)\s*$")

_CSMIP_BLOCK = re.compile(
    r"^\s*(?P<count>\d{1,9})\s+POINTS OF (?P<kind>\w+)\.? DATA EQUALLY SPACED AT\s*(?P<period>[\d.]+)\s*SEC"
    r"(?P<rest>.*)$",
    re.IGNORECASE,
)
_COSMOS_BLOCK = re.compile(
    r"^\s*(?P<count>\d{1,9})\s+(?P<kind>[A-Z .]*?)\s*\b(?:PTS|POINTS)\b(?P<rest>.*\bUNITS\s*=.*)$", re.IGNORECASE
)
_CSMIP_UNIT = re.compile(r"(?:\bUNITS\s*(?:OF|:)|\bIN(?!\s+UNITS))\s*(?P<unit>[A-Z][\w/^*]*)", re.IGNORECASE)
_COSMOS_UNIT = re.compile(
    r"\bUNITS\s*=\s*(?P<unit>[^,(]*?)\s*(?:\(\s*(?P<code>\d{1,3})\s*\))?\s*(?:,|$)", re.IGNORECASE
)
_COSMOS_LENGTH = re.compile(r"\bAPPROX\s+(?P<seconds>[\d.]+)\s*SECS?\b", re.IGNORECASE)
_COSMOS_UNIT_CODES = {2: "g", 4: "cm/s^2", 10: "cm/s^2"}
_CHANNEL = re.compile(r"^\s*(?:STA\s+)?CHAN\s*(?P<number>\d{1,9})\s*:\s*(?P<label>.*)$", re.IGNORECASE)
_STATION_CHANNEL = re.compile(r"\(\s*STA\s+CHN\s*:\s*(\d{1,9})\s*\)", re.IGNORECASE)
_REAL_HEADER = re.compile(r"^\s*(?P<count>\d{1,4})\s+REAL[- ]HEADER VALUES FOLLOW\b", re.IGNORECASE)
_FORMAT = re.compile(
    r"\(\s*(?:FORMAT\s*)?(?:1P,?(?=\d*[ED]))?(?P<repeat>\d{0,3})(?P<letter>[FEGDI])(?P<width>\d{1,3})(?:\.\d+)?E?\s*\)",
    re.IGNORECASE,
)
_NUMBERS_ONLY = re.compile(r"^[\s\d.+\-EeDd]*\d[\s\d.+\-EeDd]*$")


def read_knet(file: RecordText) -> Reading:
    """Read K-NET's or KiK-net's ASCII from the lines of a file."""
    if not file.lines[0].startswith("Origin Time"):
        raise file.error(f"{file.lines[0].strip()[:60]!r}, expected K-NET's 'Origin Time'", 1)
    memo = next((i for i, text in enumerate(file.lines) if text.startswith("Memo")), None)
    if memo is None:
        raise file.error("header without its last line, expected 'Memo.'")
    frequency_line, frequency = _knet_number(file, memo, "Sampling Freq(Hz)")
    if frequency <= 0:
        raise file.error(f"sampling frequency {frequency:g} Hz, expected more than 0", frequency_line)
    _, duration = _knet_number(file, memo, "Duration Time(s)")
    scale_line, stated = _knet_entry(file, memo, "Scale Factor")
    scale = _KNET_SCALE.search(stated)
    unit = unit_named(scale[2]) if scale else None
    if scale is None or unit is None:
        raise file.error(f"scale factor {stated[:40]!r}, expected one such as '3920(gal)/6182761'", scale_line)
    divisor = file.number(scale[3], scale_line)
    if divisor == 0:
        raise file.error(f"scale factor {stated[:40]!r}, expected a divisor other than 0", scale_line)
    factor = file.number(scale[1], scale_line) / divisor
    words = [(word, line) for line, text in enumerate(file.lines[memo + 1 :], memo + 2) for word in text.split()]
    values = [factor * file.number(word, line) for word, line in words]
    if not abs(len(values) - duration * frequency) < 0.5:
        raise file.error(f"{len(values)} values, expected {duration:g} s of {frequency:g} Hz as in the header")
    return checked_reading(values, file.errors_at([line for _, line in words]), unit=unit, sample_period=1 / frequency)


def _knet_entry(file: RecordText, memo: int, label: str) -> tuple[int, str]:
    """(line, text) of an entry of K-NET's header."""
    for line, text in enumerate(file.lines[:memo], 1):
        if text.startswith(label):
            return line, text.removeprefix(label).strip()
    raise file.error(f"header without {label!r}")


def _knet_number(file: RecordText, memo: int, label: str) -> tuple[int, float]:
    line, text = _knet_entry(file, memo, label)
    return line, file.number(text.removesuffix("Hz"), line)


@dataclass(frozen=True)
class _Block:
    """A block of accelerations: its channel, and the line (`index`, from 0) that describes it."""

    channel: int
    label: str
    index: int
    stated: re.Match[str]
    cosmos: bool
    real_header: int | None


@dataclass(frozen=True)
class _Format:
    """A Fortran format: `repeat` numbers in a row, each `width` characters wide."""

    repeat: int
    width: int
    integer: bool


_CSMIP_FORMAT = _Format(8, 10, integer=False)


def read_v2(file: RecordText, channel: str | None) -> Reading:
    """Read CSMIP's or COSMOS's volume 2.

    Parameters
    ----------
    file
        Its lines.
    channel
        Number of a channel; needed where there are several.
    """
    block = _chosen(file, _blocks(file), channel)
    line = block.index + 1
    rest = block.stated["rest"]
    count = int(block.stated["count"])
    form = _format(rest)
    if form is None and (block.cosmos or re.search(r"\((?!\s*UNITS)", rest, re.IGNORECASE)):
        raise file.error(f"{file.lines[block.index].strip()[-40:]!r}, expected a Fortran format such as (8F10.5)", line)
    form = form or _CSMIP_FORMAT
    unit = _cosmos_unit(file, rest, line) if block.cosmos else _csmip_unit(file, rest, line)
    period = _cosmos_period(file, block) if block.cosmos else file.number(block.stated["period"], line)
    if period is not None and period <= 0:
        raise file.error(f"sample period {period:g} s, expected more than 0", line)
    if block.cosmos and period is not None:
        _check_length(file, rest, count * period, line)
    fields = _fields(file, block.index + 1, count, form)
    values = [_fortran_number(file, text, at, form) for text, at in fields]
    after = block.index + 1 + math.ceil(count / form.repeat)
    following = file.lines[after] if after < len(file.lines) else ""
    if _NUMBERS_ONLY.match(following):
        raise file.error(f"values after the {count} that line {line} states", after + 1)
    return checked_reading(values, file.errors_at([at for _, at in fields]), unit=unit, sample_period=period)


def _blocks(file: RecordText) -> list[_Block]:
    """All blocks of accelerations, by the lines before them."""
    blocks: list[_Block] = []
    channel: int | None = None
    label, real_header = "", None
    for index, text in enumerate(file.lines):
        if "n" not in text and "N" not in text:  # a row of numbers
            continue
        if found := _CHANNEL.match(text):
            station = _STATION_CHANNEL.search(found["label"])
            channel = int(station[1] if station else found["number"])
            label = re.split(r"\s{2,}|\(", found["label"].strip())[0].strip()
        elif _REAL_HEADER.match(text):
            real_header = index
        elif found := _CSMIP_BLOCK.match(text) or _COSMOS_BLOCK.match(text):
            if re.search(r"\bacc", found["kind"], re.IGNORECASE):
                number = len(blocks) + 1 if channel is None else channel
                blocks.append(_Block(number, label, index, found, found.re is _COSMOS_BLOCK, real_header))
            channel, label, real_header = None, "", None
    return blocks


def _chosen(file: RecordText, blocks: list[_Block], channel: str | None) -> _Block:
    if not blocks:
        raise file.error(
            "no block of accelerations, expected a line such as '4000 points of accel data equally spaced'"
        )
    if channel is None and len(blocks) == 1:
        return blocks[0]
    listed = ", ".join(f"{block.channel} ({block.label})" if block.label else str(block.channel) for block in blocks)
    if channel is None:
        raise file.error(f"{len(blocks)} channels, expected channel as one of {listed}")
    found = [block for block in blocks if str(block.channel) == channel.strip()]
    if not found:
        raise file.error(f"no channel {channel!r}, expected one of {listed}")
    if len(found) > 1:
        raise file.error(f"{len(found)} channels {channel}, in lines {', '.join(str(b.index + 1) for b in found)}")
    return found[0]


def _format(text: str) -> _Format | None:
    """The Fortran format that a text states in brackets."""
    found = _FORMAT.search(text)
    form = _Format(int(found["repeat"] or 1), int(found["width"]), found["letter"] in "iI") if found else None
    return form if form and form.repeat and form.width else None


def _csmip_unit(file: RecordText, rest: str, line: int) -> str | None:
    found = _CSMIP_UNIT.search(rest)
    unit = unit_named(found["unit"]) if found else None
    if found and unit is None:
        raise file.error(f"unit {found['unit']!r}, expected one of {', '.join(UNITS)}", line)
    return unit


def _cosmos_unit(file: RecordText, rest: str, line: int) -> str | None:
    """The unit, stated as text, as a code, or as both."""
    found = _COSMOS_UNIT.search(rest)
    words, code = (found["unit"], found["code"]) if found else ("", None)
    units = [unit_named(words)] * bool(words) + ([_COSMOS_UNIT_CODES.get(int(code))] if code else [])
    if None in units or len(set(units)) > 1:
        coded = f" with code {code}" if code else ""
        raise file.error(f"unit {words!r}{coded}, expected g (02), cm/sec2 (04) or gal (10)", line)
    return units[0] if units else None


def _cosmos_period(file: RecordText, block: _Block) -> float | None:
    """The period [s] of the series, or else of the recorder, from the real header before the block."""
    if block.real_header is None:
        return None
    header = file.lines[block.real_header]
    found = _REAL_HEADER.match(header)
    form = _format(header)
    if found is None or form is None:
        raise file.error(f"{header.strip()[:60]!r}, expected a Fortran format", block.real_header + 1)
    fields = _fields(file, block.real_header + 1, int(found["count"]), form)
    for value, scale in ((62, 1e-3), (34, 1.0)):
        if value <= len(fields):
            period = scale * _fortran_number(file, *fields[value - 1], form)
            if period > 0:  # -999 stands for unknown
                return period
    return None


def _check_length(file: RecordText, rest: str, length: float, line: int) -> None:
    """The rounded length in the line before the numbers is to fit the period: it would show a wrong unit of time."""
    stated = _COSMOS_LENGTH.search(rest)
    if stated is None:
        return
    seconds = file.number(stated["seconds"], line)
    if abs(length - seconds) > max(1.5, 0.1 * seconds):
        raise file.error(f"about {seconds:g} s, but the period in the header makes it {length:g} s", line)


def _fields(file: RecordText, first: int, count: int, form: _Format) -> list[tuple[str, int]]:
    """(text, line) of so many fields in columns, from the line of index `first` on."""
    fields: list[tuple[str, int]] = []
    for index in range(first, first + math.ceil(count / form.repeat)):
        if index >= len(file.lines):
            raise file.error(f"ends after {len(fields)} of {count} values")
        text = file.lines[index].rstrip()
        expected = min(form.repeat, count - len(fields))
        if not (expected - 1) * form.width < len(text) <= expected * form.width:
            message = f"{text.strip()[:40]!r}, expected {expected} values in columns of {form.width}"
            raise file.error(message, index + 1)
        fields += [(text[k * form.width : (k + 1) * form.width], index + 1) for k in range(expected)]
    return fields


def _fortran_number(file: RecordText, text: str, line: int, form: _Format) -> float:
    """The number in a field; one without a decimal point is refused, as Fortran's implied decimals are unknown."""
    if not form.integer and "." not in text:
        raise file.error(f"{text.strip()!r}, expected a number with a decimal point", line)
    return file.number(text.replace("D", "E").replace("d", "e"), line)
