# SPDX-License-Identifier: Apache-2.0
"""K-NET, CSMIP and COSMOS: files in the networks' own formats are read, and damaged ones are told by line."""

import re

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_plant.records.files import read_record


def written(folder, name, text):
    path = folder / name
    path.write_bytes(text.encode())
    return path


# K-NET ----------------------------------------------------------------------------------------------------------------

COUNTS = [-10699, -10704, 15, 8388607, -8388608, 0, 1, 2, 3, 4]


def knet(counts=COUNTS, scale="3920(gal)/6182761", frequency="100Hz", duration=0.1, **replaced):
    entries = {
        "Origin Time": "2018/01/24 19:51:00",
        "Lat.": "41.0",
        "Long.": "142.5",
        "Depth. (km)": "30",
        "Mag.": "6.2",
        "Station Code": "XXX004",
        "Station Lat.": "41.4087",
        "Station Long.": "141.4486",
        "Station Height(m)": "30",
        "Record Time": "2018/01/24 19:51:37",
        "Sampling Freq(Hz)": frequency,
        "Duration Time(s)": f"{duration:g}",
        "Dir.": "E-W",
        "Scale Factor": scale,
        "Max. Acc. (gal)": "11.971",
        "Last Correction": "2018/01/24 19:51:37",
        "Memo.": "",
    }
    entries |= replaced
    header = "".join(f"{label:<18}{value}\n" for label, value in entries.items() if value is not None)
    rows = [counts[i : i + 8] for i in range(0, len(counts), 8)]
    return header + "".join("".join(f"{count:8d} " for count in row) + "\n" for row in rows)


@pytest.mark.parametrize("ending", ["EW", "NS1", "ud2"])
def test_knet_counts_become_accelerations(tmp_path, ending):
    record = read_record(written(tmp_path, f"XXX0041801241951.{ending}", knet()))
    assert (record.name, record.sample_period) == ("XXX0041801241951", 0.01)
    np.testing.assert_allclose(record.acceleration, np.array(COUNTS) * 39.20 / 6182761, rtol=1e-14)


def test_kiknet_at_200_hz_and_another_scale_is_read(tmp_path):
    text = knet(scale="7845(gal)/8223790", frequency="200Hz", duration=0.05, **{"Dir.": "5"}).replace("\n", "\r\n")
    record = read_record(written(tmp_path, "a.EW2", text), unit="cm/s^2", sample_period=0.005)
    assert record.sample_period == 0.005
    np.testing.assert_allclose(record.acceleration[0], -10699 * 78.45 / 8223790, rtol=1e-14)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("hello\n1 2 3\n", "line 1: 'hello', expected columns of numbers"),
        (knet(**{"Memo.": None}), "header without its last line, expected 'Memo.'"),
        (knet(frequency="0Hz"), "line 11: sampling frequency 0 Hz, expected more than 0"),
        (knet(scale="3920/6182761"), r"line 14: scale factor '3920/6182761', expected one such as '3920\(gal\)"),
        (knet(scale="3920(gal)/0"), "line 14: .*divisor other than 0"),
        (knet(COUNTS[:-1]), "9 values, expected 0.1 s of 100 Hz"),
        (knet().replace("     15 ", "     1S "), "line 18: '1S', expected a finite number"),
    ],
)
def test_damaged_knet_file_is_told_by_line(tmp_path, text, message):
    path = written(tmp_path, "a.EW", text)
    with pytest.raises(AbraceError, match=f"^ground motion {re.escape(str(path))}.*{message}"):
        read_record(path)


# CSMIP ----------------------------------------------------------------------------------------------------------------

TOUCHING = [-0.001239, 1.171726, -12.6262, -717.202959, 8.11021, -123.140768, -947.947485, -100.5, 75.859690, 12.0]


def rows_of(values, width=10, decimals=6, per_row=8, letter="F"):
    def field(value):
        text = f"{value:.{decimals}{letter}}"
        # Fortran leaves the 0 before the point out, and drops decimals that a column has no room for
        text = re.sub(r"^(-?)0\.", r"\1.", text) if letter == "F" else text
        return text[:width].rjust(width)

    fields = [field(value) for value in values]
    return "".join("".join(fields[i : i + per_row]) + "\n" for i in range(0, len(fields), per_row))


def csmip(values, channel="Chan  1:  90 Deg", block=None, old=False):
    count = len(values)
    unit = ".  (UNITS: CM/SEC/SEC)" if old else ", in cm/sec2. (8f10.6)"
    block = block or f"{count:6d} points of accel data equally spaced at  .020 sec{unit}    \n{rows_of(values)}"
    text = f"""Corrected accelerogram   12345-S4384-83123.01       {channel}     from
Uncorrected Accelerogram Data             Processed: 04/30/14, CGS
{channel}
Hypocenter(XXX): 36.25N,120.28W, H= 9km.
{count:6d} points of instrument- and baseline-corrected accel, veloc and displ data
At equally-spaced intervals of    .020  sec.
Peak acceleration =  -267.957    cm/sec/sec  at   10.940   sec.
12345-S4384-83123.01      A station 14              {channel}
    1    1    1    3    3    0    1    1 -999 -99915050    0
      .041      .630-999.00000      .030      .100     1.870     -.275    10.947
{block}{count:6d} points of veloc data equally spaced at  .020 sec, in cm/sec.  (8f10.7)
{rows_of([9.0] * count, decimals=7)}{count:6d} points of displ data equally spaced at  .020 sec, in cm.      (8f10.7)
{rows_of([8.0] * count, decimals=7)}/&  ----------  End of data for channel  1  ----------
"""
    return text.upper() if old else text


@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_csmip_file_is_read_though_its_numbers_touch(tmp_path, old, end):
    text = csmip(TOUCHING, old=old)
    assert "-12.626200-717.20295" in text
    record = read_record(written(tmp_path, "CHAN01.V2", text.replace("\n", end)), unit="cm/s^2")
    assert (record.name, record.sample_period) == ("CHAN01", 0.02)
    np.testing.assert_allclose(record.acceleration, np.array(TOUCHING) / 100, rtol=0, atol=1.1e-7)


def test_dos_end_of_file_mark_does_no_harm(tmp_path):
    assert len(read_record(written(tmp_path, "a.v2", csmip(TOUCHING) + "\x1a")).acceleration) == 10


THREE = (
    csmip([1.0, 2.0], "Chan  1:  90 Deg")
    + csmip([3.0, 4.0], "Chan  2:  Up      (Sta Chn: 14)     Location: Freefield")
    + csmip([5.0, 6.0], "CHAN 11: 360 DEG")
)


@pytest.mark.parametrize(("channel", "values"), [("1", [1.0, 2.0]), ("14", [3.0, 4.0]), (" 11 ", [5.0, 6.0])])
def test_channel_is_the_stations_number(tmp_path, channel, values):
    record = read_record(written(tmp_path, "a.v2", THREE), channel=channel)
    np.testing.assert_allclose(record.acceleration, np.array(values) / 100, rtol=1e-15)


@pytest.mark.parametrize(
    ("text", "channel", "message"),
    [
        (THREE, None, r"3 channels, expected channel as one of 1 \(90 Deg\), 14 \(Up\), 11 \(360 DEG\)"),
        (THREE, "2", r"no channel '2', expected channel as one of 1 \(90 Deg\), 14 \(Up\)"),
        (csmip([1.0, 2.0]), "Up", r"no channel 'Up', expected channel as one of 1 \(90 Deg\)"),
        (csmip([1.0, 2.0]) * 2, "1", "2 channels 1, in lines 11, 28"),
    ],
)
def test_channels_are_listed_where_one_is_needed(tmp_path, text, channel, message):
    with pytest.raises(AbraceError, match=message):
        read_record(written(tmp_path, "a.v2", text), channel=channel)


def test_damage_in_another_channel_does_no_harm(tmp_path):
    text = csmip([1.0, 2.0]) + csmip([3.0, 4.0], "Chan  2:  Up").replace("cm/sec2", "furlong")
    assert read_record(written(tmp_path, "a.v2", text), channel="1").acceleration[0] == 0.01


GOOD = csmip(TOUCHING)
CUT = GOOD[: GOOD.index(" 75.859690")]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("Corrected accelerogram\n", "no block of accelerations, expected a line such as '4000 points of accel data"),
        (
            GOOD.replace("    10 points of accel", "    12 points of accel"),
            "line 13: .*expected 4 values in columns of 10",
        ),
        (GOOD.replace("    10 points of accel", "     8 points of accel"), "line 13: values after the 8 that line 11"),
        (CUT, "ends after 8 of 10 values"),
        (GOOD.replace("-12.6262", "-12.6Z62"), "line 12: '-12.6Z6200', expected a finite number"),
        (GOOD.replace("-12.626200", "**********"), r"line 12: '\*{10}', expected a number with a decimal point"),
        (GOOD.replace("in cm/sec2", "in volts"), "line 11: unit 'volts', expected that of an acceleration"),
        (GOOD.replace("(8f10.6)", "(8x10.6)", 1), "line 11: .*expected a Fortran format"),
        (GOOD.replace("at  .020", "at  .000"), "line 11: sample period 0 s, expected more than 0"),
        (GOOD.replace(", in cm/sec2.", "."), "no unit in the file"),
    ],
)
def test_damaged_csmip_file_is_told_by_line(tmp_path, text, message):
    path = written(tmp_path, "a.V2", text)
    with pytest.raises(AbraceError, match=f"^ground motion {re.escape(str(path))}.*{message}"):
        read_record(path)


# COSMOS ---------------------------------------------------------------------------------------------------------------


def cosmos(
    values,
    stated="units=cm/sec2 (04),  Format=(8f10.5)",
    channel="Sta Chan   1:270 deg (Rcrdr Chan  2) Location:10",
    milliseconds=5.0,
    seconds=-999.0,
    approximately=None,
    kind="acceleration",
    rows=None,
):
    real = np.full(100, -999.0)
    real[61], real[33] = milliseconds, seconds
    length = f"{len(values) * 0.005:.0f}" if approximately is None else approximately
    return f"""Corrected {kind}   (Format v01.20 with 13 text lines)    Src: 00000000.XX
Statn No: 05- 12345  Code:CE-12345   CGS  A place
{channel}
Processed:                               Max =    34.163 cm/s^2   at  10.045 sec
Values used when parameter or data value is unknown/unspecified:   -999 -999.0
  20 Integer-header values follow on   2 lines, Format= (10I8)
{"    -999" * 10}
{"       1" * 10}
 100 Real-header values follow on  17 lines, Format= (6F13.6)
{rows_of(real, 13, 6, 6)}   1 Comment line(s) follow, each starting with a "|":
| 10000 points of nothing
{len(values):8d} {kind} pts, approx {length} secs, {stated}
{rows_of(values, decimals=5) if rows is None else rows}End-of-data for Chan  1 {kind}
"""


@pytest.mark.parametrize(
    ("stated", "factor"),
    [
        ("units=cm/sec2 (04),  Format=(8f10.5)", 0.01),
        ("units=cm/sec2(04), Format=(8F10.3)", 0.01),
        ("units=cm/s^2,Format=(8F10.5)", 0.01),
        ("units=(04),Format=(8F10.5)", 0.01),
        ("units=g (02), Format=(8F10.5)", 9.80665),
        ("units=gal (10), Format=(8F10.5)", 0.01),
    ],
)
@pytest.mark.parametrize("ending", ["V2", "v2", "V2c"])
def test_cosmos_file_is_read_with_its_unit_in_words_or_code(tmp_path, stated, factor, ending):
    record = read_record(written(tmp_path, f"a.{ending}", cosmos(TOUCHING, stated)))
    assert record.sample_period == pytest.approx(0.005, rel=1e-12)
    np.testing.assert_allclose(record.acceleration, np.array(TOUCHING) * factor, rtol=0, atol=5.1e-6 * factor)


@pytest.mark.parametrize("format_and_width", [("1E15.6", 15), ("1F15.6E", 15), ("6E12.3", 12), ("1P5E13.5", 13)])
def test_cosmos_numbers_with_exponents_are_read_by_the_stated_format(tmp_path, format_and_width):
    form, width = format_and_width
    per_row = int(form[-6:].lstrip("P")[0]) if form[0] != "1" or "P" in form else 1
    decimals = int(form.rstrip("E")[-1])
    values = [-2.770328e-05, 1.5, -973.125, 1e-12, 3e4, -1.0, 2.0]
    rows = rows_of(values, width, decimals, per_row, "E")
    text = cosmos(values, f"units=cm/s^2 (4),Format=({form})", rows=rows)
    record = read_record(written(tmp_path, "a.v2", text))
    np.testing.assert_allclose(record.acceleration * 100, values, rtol=5.1 * 10.0 ** -(decimals + 1))


def test_cosmos_with_fields_of_another_width_that_touch_is_read(tmp_path):
    values = [-0.00003] * 13
    rows = "".join("-0.00003" * n + "\n" for n in (10, 3))
    record = read_record(written(tmp_path, "a.v2", cosmos(values, "units=cm/s^2 (4),Format=(10F8.5)", rows=rows)))
    np.testing.assert_allclose(record.acceleration, [-3e-7] * 13, rtol=1e-12)


def test_cosmos_period_is_the_series_or_else_the_recorders_or_the_callers(tmp_path):
    def period(**given):
        sample_period = given.pop("sample_period", None)
        return read_record(
            written(tmp_path, "a.v2", cosmos(TOUCHING, **given)), sample_period=sample_period
        ).sample_period

    assert period(milliseconds=5.0, seconds=0.01) == pytest.approx(0.005)
    assert period(milliseconds=-999.0, seconds=0.01) == pytest.approx(0.01)
    assert period(milliseconds=-999.0, sample_period=0.02) == 0.02
    with pytest.raises(AbraceError, match="no times in the file, expected sample_period"):
        period(milliseconds=-999.0)
    with pytest.raises(AbraceError, match=r"sample period 0.005 s, 0.02 s was given"):
        period(sample_period=0.02)
    with pytest.raises(AbraceError, match=r"line 29: about 50 s, but the period in the header makes it 0.05 s"):
        period(approximately="50")


def test_cosmos_velocity_and_displacement_are_passed_over(tmp_path):
    text = "".join(
        cosmos(
            [number, number], kind=kind, channel=f"Sta Chan {channel:3d}: Up  (Rcrdr Chan  1) Location:", stated=stated
        )
        for number, (channel, kind, stated) in enumerate(
            [
                (7, "velocity", "units=cm/sec (05), Format=(8f10.5)"),
                (7, "acceleration", "units=cm/sec2 (04), Format=(8f10.5)"),
                (7, "displacement", "units=cm (06), Format=(8f10.5)"),
                (8, "uncor. accel.", "units=cm/sec2 (04), Format=(8f10.5)"),
            ]
        )
    )
    path = written(tmp_path, "a.v2c", text)
    assert read_record(path, channel="7").acceleration.tolist() == [0.01, 0.01]
    assert read_record(path, channel="8").acceleration.tolist() == [0.03, 0.03]
    with pytest.raises(AbraceError, match=r"2 channels, expected channel as one of 7 \(Up\), 8 \(Up\)"):
        read_record(path)


COSMOS = cosmos(TOUCHING)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (cosmos(TOUCHING, "units=cm/sec2 (02),Format=(8F10.5)"), "line 29: unit 'cm/sec2' with code 02"),
        (cosmos(TOUCHING, "units=cm/sec2 (04)"), "line 29: .*expected a Fortran format"),
        (cosmos(TOUCHING, "units=cm/sec2 (04), Format=(8F12.5)"), "line 30: .*expected 8 values in columns of 12"),
        (COSMOS.replace("     5.000000", "     5.0O0000"), "line 20: '     5.0O0000', expected a finite number"),
        (cosmos(TOUCHING, "units= , Format=(8F10.5)"), "no unit in the file"),
    ],
)
def test_damaged_cosmos_file_is_told_by_line(tmp_path, text, message):
    path = written(tmp_path, "a.v2", text)
    with pytest.raises(AbraceError, match=f"^ground motion {re.escape(str(path))}.*{message}"):
        read_record(path)
