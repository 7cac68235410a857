# SPDX-License-Identifier: Apache-2.0
"""Readers of the formats of strong-motion networks: K-NET and KiK-net, CSMIP, COSMOS, GeoNet, USGS SMC.

- K-NET and KiK-net ASCII: a header of 17 lines, then counts of the digitiser; the scale factor in the header,
  `3920(gal)/6182761`, makes them gal (cm/s^2). The counts include the sensor's offset, which remains.
- CSMIP, COSMOS of volumes 1 and 2: a line with the number of points and the unit precedes each block of numbers, which
  are Fortran's: in columns of a stated width (older files of CSMIP state none: 8F10, or 8F9); neighbours may touch.
  Velocity, displacement and the rest of the headers are ignored. COSMOS gives the period in its real header: value 62
  [ms], that of the series, before value 34 [s], that of the recorder. A unit code (COSMOS table 2) must agree with the
  unit in words.
- Volume 1 as Caltech had it (BHRC, RENADIC, USC): 13 lines, 7 of integers, 7 of reals, then values in g/10, or pairs of
  time and value; those that a film left uneven are refused.
- GeoNet (V1A, V2A), SMC: the numbers of values are in integer headers, units are mm/s^2 and cm/s^2.

Where a file holds several channels, the channel is the station's number of one (`Sta Chn`, else `Chan`).

References: NIED, "About K-NET ASCII format"; COSMOS Strong Motion Data Format, version 1.20 (2001); CSMIP's files from
1979 to 2021.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.files.even_times import even_step, half_last_digits
from abrace_plant.records.reading import Reading, checked_reading, factor_of

if TYPE_CHECKING:
    from abrace_core import AbraceError
    from abrace_plant.records.asked import Asked
    from abrace_plant.records.reading import RecordText

_KNET_SCALE = re.compile(r"([\d.]+)\s*\(\s*(\w+)\s*\)\s*/\s*([\d.]+)\s*$")

_CSMIP_BLOCK = re.compile(
    r"^\s*(?P<count>\d{1,9})\s+POINTS OF (?P<kind>\w+)\.? DATA EQUALLY SPACED AT\s*(?P<period>[\d.]+)\s*SEC"
    r"(?P<rest>.*)$",
    re.IGNORECASE,
)
_COSMOS_BLOCK = re.compile(
    r"^\s*(?P<count>\d{1,9})\s+(?P<kind>[A-Z .]*?)\s*\b(?:PTS|POINTS)\b(?P<rest>.*\bUNITS\s*=.*)$", re.IGNORECASE
)
_VOLUME_1_BLOCK = re.compile(
    r"^\s*(?P<count>\d{1,9})\s+(?P<kind>ACCEL)\w*\.? POINTS AT\s*(?P<rate>[\d.]+)\s*PTS/SEC(?P<rest>.*)$", re.IGNORECASE
)
_CSMIP_UNIT = re.compile(r"(?:\bUNITS\s*(?:OF|:)?|\bIN(?!\s+UNITS))\s*(?P<unit>[A-Z][\w/^*]*)", re.IGNORECASE)
_COSMOS_UNIT = re.compile(
    r"\bUNITS\s*=\s*(?P<unit>[^,(]*?)[\s.]*(?:\(\s*(?P<code>\d{1,3})\s*\))?\s*(?:,|$|FORMAT)", re.IGNORECASE
)
_COSMOS_LENGTH = re.compile(r"\bAPPROX\s+(?P<seconds>[\d.]+)\s*SECS?\b", re.IGNORECASE)
_COSMOS_UNIT_CODES = {2: "g", 4: "cm/s^2", 10: "cm/s^2"}
_CHANNEL = re.compile(r"^\s*(?:STA\s+)?CHAN\s*(?P<number>\d{1,9})\s*:\s*(?P<label>.*)$", re.IGNORECASE)
_STATION_CHANNEL = re.compile(r"\(\s*STA\s+CHN\s*:\s*(\d{1,9})\s*\)", re.IGNORECASE)
_REAL_HEADER = re.compile(
    r"^\s*(?P<count>\d{1,4})\s+REAL[- ]HEADER VALUES FOLLOW\b(?:\s*ON\s*(?P<lines>\d+))?", re.IGNORECASE
)
_FORMAT = re.compile(
    r"\(\s*(?:FORMAT\s*)?(?:1P,?(?=\d*[ED]))?(?P<repeat>\d{0,3})(?P<letter>[FEGDI])(?P<width>\d{1,3})(?:\.\d+)?E?\s*\)",
    re.IGNORECASE,
)
_SMC = re.compile(
    r"^\s*(?P<code>\d)\s+(?P<kind>[A-Z ]*(?:ACCELEROGRAM|VELOCITY|DISPLACEMENT|SPECTR\w+)[A-Z ]*)$", re.IGNORECASE
)
_GEONET = re.compile(r"^(?:Unc|C)orrected accelerogram.*GNS Science", re.IGNORECASE)
_CALTECH = re.compile(r"^UNITS (?:ARE|OF).*\bG/10\b", re.IGNORECASE)
_CALTECH_CHANNEL = re.compile(r"^(?:COMP|CHAN)\b\s*(?:\d+:)?(?P<label>[^(]*)", re.IGNORECASE)
_NOT_READ = (
    (r"^Response and Fourier amplitude spectra", "CSMIP volume 3: spectra", "its volume 2"),
    (r"^(?=.*\bspectr)(?=.*\(Format v\d)", "COSMOS volume 3: spectra", "its volume 2"),
    (r"^(?:velocity|displacement|veloc|displ).*\(Format v\d", "COSMOS of another motion", "that of the acceleration"),
)
"""Formats that are known by a line, and not read, and what to give instead."""
_NUMBERS_ONLY = re.compile(r"^[\s\d.+\-EeDd]*\d[\s\d.+\-EeDd]*$")


def is_knet(lines: list[str]) -> bool:
    """Whether the lines of a file begin as those of K-NET and KiK-net do."""
    return lines[0].startswith("Origin Time") and any(line.startswith(("Scale Factor", "Memo")) for line in lines[:20])


def read_knet(file: RecordText) -> Reading:
    """Read K-NET's or KiK-net's ASCII from the lines of a file."""
    memo = next((i for i, text in enumerate(file.lines) if text.startswith("Memo")), None)
    if memo is None:
        raise file.error("header without its last line, expected 'Memo.'")
    frequency_line, frequency = _knet_number(file, memo, "Sampling Freq(Hz)")
    if frequency <= 0:
        raise file.error(f"sampling frequency {frequency:g} Hz, expected more than 0", frequency_line)
    _, duration = _knet_number(file, memo, "Duration Time(s)")
    scale_line, stated = _knet_entry(file, memo, "Scale Factor")
    scale = _KNET_SCALE.search(stated)
    unit = scale[2] if scale else ""
    if scale is None or factor_of(unit) is None:
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
class _Format:
    """A Fortran format: `repeat` numbers in a row, each `width` characters wide."""

    repeat: int
    width: int
    integer: bool = False


@dataclass(frozen=True)
class _Block:
    """A block of accelerations of a channel, stated in the line of `index` (from 0)."""

    channel: int
    label: str
    index: int
    stated: re.Match[str] | None = None
    real_header: int | None = None


def has_blocks(file: RecordText) -> bool:
    """Whether a `file` is in a format that `read_blocks` knows, or refuses by its name."""
    top = "\n".join(file.lines[:30])
    known = (
        _GEONET.match(file.lines[0]),
        _SMC.match(file.lines[0]) and file.lines[1:2] and file.lines[1].startswith("*"),
    )
    return bool(
        any(known)
        or _not_read(top)
        or re.search(r"\(Format v\d\d\.\d\d|^(?:un)?corrected accelerogram", file.lines[0], re.IGNORECASE)
        or _blocks(file)
    )


def _not_read(top: str) -> tuple[str, str] | None:
    return next(
        (
            (kind, instead)
            for form, kind, instead in _NOT_READ
            if re.search(form, top, re.IGNORECASE | re.MULTILINE | re.DOTALL)
        ),
        None,
    )


def read_blocks(file: RecordText, asked: Asked) -> Reading:
    """Read the channel of a `file` of CSMIP, COSMOS, GeoNet, SMC that is `asked` for, or the only one.

    Raises
    ------
    AbraceError
        If there is none, or the file is of another motion or in a format that is not read: which.
    """
    blocks = _blocks(file)
    if not blocks and (refused := _not_read("\n".join(file.lines[:30]))):
        raise file.error(f"{refused[0]}, not read: expected {refused[1]}")
    if smc := _SMC.match(file.lines[0]):
        return _read_smc(file, smc, asked)
    counts = [
        block
        for block in blocks
        if block.stated and re.search(r"units\s*=\s*counts", block.stated["rest"], re.IGNORECASE)
    ]
    if counts:
        raise file.error("counts of the digitiser (COSMOS volume 0), expected volume 1 or 2", counts[0].index + 1)
    block = _chosen(file, blocks, asked)
    chosen = f"channel {block.channel}" + (f" ({block.label})" if block.label else "")
    if block.stated is None:
        return (_read_geonet if _GEONET.match(file.lines[0]) else _read_caltech)(file, block, chosen)
    line = block.index + 1
    rest, cosmos, count = block.stated["rest"], block.stated.re is _COSMOS_BLOCK, int(block.stated["count"])
    form = _format(rest)
    if form is None and (cosmos or re.search(r"\((?!\s*UNITS)", rest, re.IGNORECASE)):
        raise file.error(f"{file.lines[block.index].strip()[-40:]!r}, expected a Fortran format such as (8F10.5)", line)
    unit = _cosmos_unit(file, rest, line) if cosmos else _csmip_unit(file, rest, line)
    stated = block.stated.groupdict()
    if cosmos:
        period = _cosmos_period(file, block)
    elif "rate" in stated:
        period = 1 / max(file.number(stated["rate"], line), 1e-9)
    else:
        period = file.number(stated["period"], line)
    if period is not None and period <= 0:
        raise file.error(f"sample period {period:g} s, expected more than 0", line)
    if cosmos and period is not None:
        _check_length(file, rest, count * period, line)
    row = file.lines[line].rstrip() if line < len(file.lines) else ""
    form = form or _Format(8, 9 if len(row) == 72 else 10)
    return _read_values(file, line, count, form, unit, period, chosen)


def _read_values(
    file: RecordText, first: int, count: int, form: _Format, unit: str | None, period: float | None, chosen: str
) -> Reading:
    """So many values in columns, from the line of index `first` on."""
    fields = _fields(file, first, count, form)
    values = [_fortran_number(file, text, at, form) for text, at in fields]
    after = first + math.ceil(count / form.repeat)
    following = file.lines[after] if after < len(file.lines) else ""
    if _NUMBERS_ONLY.match(following) and not _GEONET.match(file.lines[0]):
        raise file.error(f"values after the {count} that line {first} states", after + 1)
    error_at = file.errors_at([at for _, at in fields])
    return checked_reading(values, error_at, unit=unit, sample_period=period, chosen=chosen)


def _read_smc(file: RecordText, smc: re.Match[str], asked: Asked) -> Reading:
    """USGS's SMC: 11 lines, 48 integers, 50 reals, as many comments as integer 16 says, values in cm/s^2."""
    kind = f"USGS SMC, {smc['kind'].strip().lower()}"
    if "ACCELEROGRAM" not in smc["kind"].upper():
        raise file.error(f"{kind}: expected an accelerogram")
    if asked.channel is not None:
        raise file.error(f"channel {asked.channel!r} was given, expected none: the format has only one")
    if len(file.lines) < 28:
        raise file.error(f"{kind}: {len(file.lines)} lines, expected a header of 27 and values")
    whole, real = _Format(8, 10, integer=True), _Format(5, 15)
    integers, reals = _fields(file, 11, 48, whole), _fields(file, 17, 50, real)
    comments, count = (int(_fortran_number(file, *integers[k], whole)) for k in (15, 16))
    rate = _fortran_number(file, *reals[1], real)
    if not (count > 1 and comments >= 0 and 0 < rate < 1e5):
        raise file.error(f"{kind}: {count} values, {comments} comments, {rate:g} Hz, expected these in its headers")
    return _read_values(file, 27 + comments, count, _Format(8, 10), "cm/s^2", 1 / rate, kind)


def _read_geonet(file: RecordText, block: _Block, chosen: str) -> Reading:
    """A component of GeoNet's V1A or V2A: 16 lines, 4 of integers, 6 of reals, values in mm/s^2."""
    whole, real = _Format(10, 8, integer=True), _Format(10, 8)
    count = int(_fortran_number(file, *_fields(file, block.index + 19, 10, whole)[3], whole))
    period = _fortran_number(file, *_fields(file, block.index + 22, 10, real)[5], real)
    if not (count > 1 and period > 0):
        raise file.error(f"GeoNet: {count} values every {period:g} s, expected these in its headers", block.index + 20)
    return _read_values(file, block.index + 26, count, _Format(10, 8), "mm/s^2", period, chosen)


def _read_caltech(file: RecordText, block: _Block, chosen: str) -> Reading:
    """A component of a volume 1 in g/10: values every duration / count, or pairs of time and value."""
    top = "\n".join(file.lines[block.index : block.index + 13])
    points = re.search(r"POINTS\s*=\s*(\d+)", top, re.IGNORECASE)
    length = re.search(r"(?:DURATION|RECORD LENGTH)\s*=\s*([\d.]+)", top, re.IGNORECASE)
    first = block.index + 27
    row = file.lines[first].rstrip() if first < len(file.lines) else ""
    if points is None or length is None or len(row) not in (130, 70, 80):
        raise file.error("volume 1 in another form than that of BHRC and RENADIC, expected its volume 2", first + 1)
    count, seconds = int(points[1]), file.number(length[1], block.index + 11)
    if len(row) == 130:
        return _read_values(file, first, count, _Format(10, 13), "g/10", seconds / count, chosen)
    form = _Format(10, len(row) // 10)
    fields = _fields(file, first, 2 * count, form)
    pairs = np.array([_fortran_number(file, *each, form) for each in fields]).reshape(-1, 2)

    def error_at(message: str, sample: int | None) -> AbraceError:
        what = "volume 1 of a film, expected its volume 2: "
        return file.error(what + message, None if sample is None else fields[2 * sample][1])

    period, wrong = even_step(pairs[:, 0], half_last_digits([text for text, _ in fields[::2]]), None, error_at)
    for sample, text in wrong.items():
        raise error_at(text, sample)
    return checked_reading(pairs[:, 1], error_at, unit="g/10", sample_period=period, chosen=chosen)


def _blocks(file: RecordText) -> list[_Block]:
    """All blocks of accelerations, by the lines before them."""
    if _GEONET.match(file.lines[0]):
        starts = [index for index, text in enumerate(file.lines) if _GEONET.match(text)]
        names = ["".join(file.lines[start + 12 : start + 13]).removeprefix("Component").split() for start in starts]
        return [
            _Block(i, (name or [""])[0], start) for i, (name, start) in enumerate(zip(names, starts, strict=True), 1)
        ]
    blocks: list[_Block] = []
    if any(map(_CALTECH.match, file.lines[:13])) and "CORRECTED" not in file.lines[0].upper().split()[:1]:
        for index, text in enumerate(file.lines[6:]):
            if (found := _CALTECH_CHANNEL.match(text)) and any(map(_CALTECH.match, file.lines[index : index + 13])):
                blocks.append(_Block(len(blocks) + 1, found["label"].strip(), index))
        return blocks
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
        elif found := _CSMIP_BLOCK.match(text) or _COSMOS_BLOCK.match(text) or _VOLUME_1_BLOCK.match(text):
            if re.search(r"\bacc", found["kind"], re.IGNORECASE):
                number = len(blocks) + 1 if channel is None else channel
                blocks.append(_Block(number, label, index, found, real_header))
            channel, label, real_header = None, "", None
    return blocks


def _chosen(file: RecordText, blocks: list[_Block], asked: Asked) -> _Block:
    if not blocks:
        raise file.error(
            "no block of accelerations, expected a line such as '4000 points of accel data equally spaced'"
        )
    if asked.channel is None and len(blocks) == 1:
        return blocks[0]
    listed = [f"{block.channel} ({block.label})" if block.label else str(block.channel) for block in blocks]
    if asked.channel is None:
        raise file.error(f"{len(blocks)} channels, expected {asked.one_of(listed)}")
    found = [block for block in blocks if asked.channel.strip() in (str(block.channel), block.label)]
    if not found:
        raise file.error(f"no channel {asked.channel!r}, expected {asked.one_of(listed)}")
    if len(found) > 1:
        where = ", ".join(str(block.index + 1) for block in found)
        raise file.error(f"{len(found)} channels {asked.channel}, in lines {where}")
    return found[0]


def _format(text: str) -> _Format | None:
    """The Fortran format that a text states in brackets."""
    found = _FORMAT.search(text)
    form = _Format(int(found["repeat"] or 1), int(found["width"]), found["letter"] in "iI") if found else None
    return form if form and form.repeat and form.width else None


def _csmip_unit(file: RecordText, rest: str, line: int) -> str | None:
    found = _CSMIP_UNIT.search(rest)
    if found and factor_of(found["unit"]) is None:
        raise file.error(f"unit {found['unit']!r}, expected that of an acceleration", line)
    return found["unit"] if found else None


def _cosmos_unit(file: RecordText, rest: str, line: int) -> str | None:
    """The unit, stated as text, as a code, or as both."""
    found = _COSMOS_UNIT.search(rest)
    words, code = (found["unit"], found["code"]) if found else ("", None)
    coded = _COSMOS_UNIT_CODES.get(int(code)) if code else words
    if (words or code) and (coded is None or factor_of(words or coded) != factor_of(coded) or factor_of(coded) is None):
        with_code = f" with code {code}" if code else ""
        raise file.error(f"unit {words!r}{with_code}, expected g (02), cm/sec2 (04) or gal (10)", line)
    return words or coded or None


def _cosmos_period(file: RecordText, block: _Block) -> float | None:
    """The period [s] of the series, or else of the recorder, from the real header before the block."""
    if block.real_header is None:
        return None
    header = file.lines[block.real_header]
    found = _REAL_HEADER.match(header)
    form = _format(header)
    if found is None or form is None:
        raise file.error(f"{header.strip()[:60]!r}, expected a Fortran format", block.real_header + 1)
    lines = int(found["lines"] or math.ceil(int(found["count"]) / form.repeat))
    fields = _fields(file, block.real_header + 1, min(int(found["count"]), lines * form.repeat), form)
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
