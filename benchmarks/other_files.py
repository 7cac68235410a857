# SPDX-License-Identifier: Apache-2.0
"""Files as other people write them, all values invented: each is read exactly, or refused with the words that help."""

from __future__ import annotations

import gzip
import io
import re
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from claims import Claim
from scipy import io as matlab

from abrace_core import AbraceError
from abrace_plant.records.files import read_record

VALUES = (0.5, -1.25, 2.0, 0.75, -0.25, 0.125, 1.5, -0.625)
G, GAL = 9.80665, 0.01


class OtherFile(NamedTuple):
    """A file, how it is read, and what is right: values in m/s^2 and sample period [s], or words of the refusal."""

    name: str
    content: bytes
    given: dict[str, Any]
    right: tuple[float, float] | str
    """Factor of VALUES to m/s^2, and sample period [s]."""


def _text(*lines: str) -> bytes:
    return "\n".join([*lines, ""]).encode()


def _columns(separator: str, *heads: str, step: float = 0.02, form: str = "%.2f", more: str = "") -> bytes:
    rows = [f"{form % (k * step)}{separator}{value:g}{more}" for k, value in enumerate(VALUES)]
    return _text(*heads, *rows)


def _comma(content: bytes) -> bytes:
    return content.replace(b".", b",")


def _fixed(width: int, decimals: int, count: int) -> list[str]:
    cells = [f"{value:{width}.{decimals}f}" for value in VALUES]
    return ["".join(cells[i : i + count]) for i in range(0, len(cells), count)]


def _mat(**variables: Any) -> bytes:
    file = io.BytesIO()
    matlab.savemat(file, variables)  # type: ignore[arg-type]
    return file.getvalue()


def _npz(**arrays: Any) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def _chan(number: int, line: str, width: int) -> list[str]:
    return [f"Chan  {number}:  90 Deg (Sta Chn: {number})", line, *_fixed(width, 5, 8)]


def _volume_1(component: str, length: str, rows: list[str]) -> list[str]:
    head = ["Volume 1", *["-"] * 5, component, *["-"] * 3]
    zeros = ["    0" * 10] * 7 + ["  .000" * 8] * 7
    return [*head, f"NO. OF POINTS = 8  {length} = 0.080", "UNITS ARE SECONDS AND G/10", "-", *zeros, *rows]


def _smc(kind: str) -> bytes:
    integers, reals = ["    -32768"] * 48, ["  0.1700000E+39"] * 50
    integers[15], integers[16], reals[1] = "         1", "         8", "  0.1000000E+03"
    lines = [f"{kind}", "*", *["*"] * 9]
    lines += ["".join(integers[i : i + 8]) for i in range(0, 48, 8)] + [
        "".join(reals[i : i + 5]) for i in range(0, 50, 5)
    ]
    return _text(
        *lines,
        "| a comment",
        "".join(f"{value:10.3E}".replace("E-0", "E-").replace("E+0", "E+")[:10].rjust(10) for value in VALUES),
    )


def _geonet() -> list[str]:
    whole = ["       0" * 10] * 3 + ["       0" * 3 + "       8" + "       0" * 6]
    real = ["   0.000" * 10] * 2 + ["   0.000" * 5 + "  0.0200" + "   0.000" * 4] + ["   0.000" * 10] * 3
    head = ["Corrected accelerogram X GNS Science", *["-"] * 11, "Component N10E", *["-"] * 3]
    return [*head, *whole, *real, *_fixed(8, 3, 10)]


def other_files() -> list[OtherFile]:
    """The files, by kinds."""
    knet = ["Origin Time       2000/01/01 00:00:00", "Sampling Freq(Hz) 100Hz", "Duration Time(s)  0.08"]
    counts = " ".join(f"{1000 * value:.0f}" for value in VALUES)
    cosmos = ["Uncorrected acceleration  (Format v01.20 with 13 text lines)", "Chan  1: 360 deg"]
    peer = [
        "PEER STRONG MOTION DATABASE RECORD",
        "X, 1/1/00",
        "{} TIME HISTORY IN UNITS OF {}",
        "NPTS=   8, DT=   .0100 SEC",
    ]
    at2 = "\n".join([*peer, *_fixed(14, 6, 5), ""])
    two = "\n".join(f"{k * 0.02:.2f} {value:g} {2 * value:g}" for k, value in enumerate(VALUES))
    rows = np.vstack([0.02 * np.arange(8), VALUES])
    g, step = {"unit": "g"}, {"sample_period": 0.01}
    both = {**g, **step}
    csv = "time [s],acc [m/s^2]"
    heading = {"channel": "2"}
    points = "  8 points of accel data equally spaced at .010 sec, in cm/sec2. (8f10.5)"
    two_channels = _text(*_chan(1, points, 10), *_chan(2, points, 10))
    fortran = "\n".join(f"{0.02 * k:12.4E} {value:14.6E}".replace("E", "D") for k, value in enumerate(VALUES))
    pairs = [f"{0.02 * k:.2f} {value:g}" for k, value in enumerate(VALUES)]
    return [
        # as programs print them: Fortran's exponents, several pairs of a time and a value in a row
        OtherFile("fortran.txt", _text("TIME(S)  ACC(G)", fortran), {}, (G, 0.02)),
        OtherFile("pairs.txt", _text("  ".join(pairs[:4]), "  ".join(pairs[4:])), g, (G, 0.02)),
        OtherFile("three_pairs.txt", _text(*("  ".join(pairs[i : i + 3]) for i in (0, 3, 6))), g, (G, 0.02)),
        OtherFile("fixed.eq", _text("(3F9.6)", *_fixed(9, 6, 3)), both, (G, 0.01)),
        OtherFile(
            "shake.eq", _text("(4F9.6)", *(f"{row}{k:8d}" for k, row in enumerate(_fixed(9, 6, 4), 1))), both, (G, 0.01)
        ),
        OtherFile(
            "geocsv.csv",
            _columns(",", "# dataset: GeoCSV 2.0", "# sample_rate_hz: 50", "# field_unit: s, cm/s^2", "Time,Sample"),
            {"channel": "Sample"},
            (GAL, 0.02),
        ),
        # known formats under any ending
        OtherFile("peer.dat", at2.format("ACCELERATION", "G").encode(), {}, (G, 0.01)),
        OtherFile(
            "displacement.dt2",
            at2.format("DISPLACEMENT", "CM").encode(),
            {},
            "DISPLACEMENT.*expected the file of the acceleration",
        ),
        OtherFile(
            "velocity.at2",
            at2.format("VELOCITY", "CM/S").encode(),
            {},
            "VELOCITY.*expected the file of the acceleration",
        ),
        OtherFile("k.knet", _text(*knet, "Scale Factor      2000(gal)/2000000", "Memo.", counts), {}, (GAL, 0.01)),
        OtherFile(
            "volume2.txt",
            _text(*_chan(1, "    8 points of accel data equally spaced at  .010 sec, in cm/sec2. (8f10.5)", 10)),
            {},
            (GAL, 0.01),
        ),
        OtherFile(
            "uncorrected.v1",
            _text(
                "Uncorrected Accelerogram Data",
                *_chan(1, "     8 Accelerogram points at 100 pts/sec in units of g.  Format: (8f9.5)", 9),
            ),
            {},
            (G, 0.01),
        ),
        OtherFile(
            "no_format.raw",
            _text(*_chan(1, "8 POINTS OF ACCEL DATA EQUALLY SPACED AT .010 SEC.  (UNITS: G)", 9)),
            {},
            (G, 0.01),
        ),
        OtherFile("two.v2", two_channels, {}, r"2 channels, .*channel='1'"),
        OtherFile("two.v2", two_channels, {"channel": 2}, (GAL, 0.01)),
        OtherFile(
            "raw.v1c",
            _text(
                *cosmos,
                "  34 Real-header values follow on   5 lines, Format= (8F10.3)",
                *["  -999.000" * 8] * 4,
                "  -999.000     0.005",
                "     8 acceleration pts, approx   0 secs, units=g.     (02)Format=(8f9.5)",
                *_fixed(9, 5, 8),
            ),
            {},
            (G, 0.005),
        ),
        OtherFile(
            "counts.v0c",
            _text(
                "Raw acceleration counts   (Format v01.20 with 13 text lines)",
                "8 raw accel.   pts, approx  0 secs, units=counts (50),Format=(8I8)",
                "       1" * 8,
            ),
            {},
            "counts of the digitiser .*expected volume 1 or 2",
        ),
        OtherFile(
            "spectra.v3",
            _text("Response and Fourier amplitude spectra (78 periods) for", "Corrected accelerogram"),
            {},
            "volume 3: spectra, not read: expected its volume 2",
        ),
        OtherFile(
            "pairs.v1",
            _text(
                *_volume_1(
                    "CHAN  1: EW",
                    "RECORD LENGTH",
                    [
                        "".join(f"{0.01 * k:7.3f}{value:7.3f}" for k, value in enumerate(VALUES[:5])),
                        "".join(f"{0.01 * k:7.3f}{value:7.3f}" for k, value in enumerate(VALUES) if k > 4),
                    ],
                )
            ),
            {},
            (G / 10, 0.01),
        ),
        OtherFile(
            "film.v1",
            _text(
                *_volume_1(
                    "COMP N",
                    "DURATION",
                    [
                        "".join(f"{0.01 * k**1.3:7.3f}{value:7.3f}" for k, value in enumerate(VALUES[:5])),
                        "".join(f"{0.01 * k**1.3:7.3f}{value:7.3f}" for k, value in enumerate(VALUES) if k > 4),
                    ],
                )
            ),
            {},
            "volume 1 of a film, expected its volume 2",
        ),
        OtherFile("a.smc", _smc("2 CORRECTED ACCELEROGRAM"), {}, (GAL, 0.01)),
        OtherFile("v.smc", _smc("3 VELOCITY"), {}, "USGS SMC, velocity: expected an accelerogram"),
        OtherFile("n.V2A", _text(*_geonet()), {}, (0.001, 0.02)),
        # tables
        OtherFile(
            "esm.asc",
            _text(
                "NETWORK: XX",
                "SAMPLING_INTERVAL_S: 0.005000",
                "NDATA: 8",
                "UNITS: cm/s^2",
                "DATA_TYPE: ACCELERATION",
                "USER1: ",
                *map(str, VALUES),
            ),
            {},
            (GAL, 0.005),
        ),
        OtherFile(
            "esm.asc",
            _text("SAMPLING_INTERVAL_S: 0.005000", "UNITS: cm/s", "DATA_TYPE: VELOCITY", *map(str, VALUES)),
            {},
            "unit 'cm/s' of the values, expected an acceleration's",
        ),
        OtherFile(
            "afad.txt",
            _text(
                "STRONG GROUND MOTION RECORDS",
                "NUMBER OF DATA          : 8",
                "SAMPLING INTERVAL (sec) : 0.01",
                "   N-S    E-W    U-D",
                *(f" {2 * value} {value} {value / 2}" for value in VALUES),
            ),
            {},
            "expected channel as one of N-S, E-W, U-D",
        ),
        OtherFile(
            "afad.txt",
            _text(
                "SAMPLING INTERVAL (sec) : 0.01",
                "   N-S    E-W    U-D",
                *(f" {2 * value} {value} {value / 2}" for value in VALUES),
            ),
            {"channel": "e-w", "unit": "cm/s^2"},
            (GAL, 0.01),
        ),
        OtherFile(
            "cwb.dat",
            b"#SampleRate(Hz): 50\n#AmplitudeUnit:  gal. DCoffset(corr)\n#Data: 3F10.3\n" + two.encode(),
            heading,
            (GAL, 0.02),
        ),
        OtherFile(
            "jma.csv",
            "SITE CODE= X\u5e02,35.0,135.0\n SAMPLING RATE= 100Hz\n UNIT  = gal(cm/s/s)\n NS,EW\n".encode("shift_jis")
            + _text(*(f"{-value},{value}" for value in VALUES)),
            {"channel": "EW"},
            (GAL, 0.01),
        ),
        OtherFile(
            "unam.191",
            _text(
                "INTERVALO DE MUESTREO, C1-C6 (s)       : /0.005/0.005",
                "UNIDADES DE LOS DATOS                  : Gal (cm/s/s)",
                "---------+---------+",
                "   CANAL-1   CANAL-2",
                "         V      N90E",
                "---------+---------+",
                *(f"{-value:10.4f}{value:10.4f}" for value in VALUES),
            ),
            {"channel": "N90E"},
            (GAL, 0.005),
        ),
        OtherFile(
            "sep.csv",
            _text(
                "sep=;",
                "Tag:;X",
                "",
                "t [ms];Acc_X [m/s^2];Acc_Y [m/s^2]",
                *(f"{10 * k};{value};{-value}" for k, value in enumerate(VALUES)),
            ),
            {"channel": "Acc_X"},
            (1.0, 0.01),
        ),
        OtherFile("decimal_comma.csv", _comma(_columns("\t", '"Time (s)"\t"Acceleration x (m/s^2)"')), {}, (1.0, 0.02)),
        OtherFile(
            "quoted.csv",
            _text(
                csv,
                *(
                    f'"{0.02 * k:.2f}";"{value:.3f}"'.replace(".", ",").replace(";", ",")
                    for k, value in enumerate(VALUES)
                ),
            ),
            {},
            (1.0, 0.02),
        ),
        OtherFile("one_comma.txt", _comma(_text(*(f"{value:.3f}" for value in VALUES))), both, (G, 0.01)),
        OtherFile(
            "whole_numbers.txt", b"1,5\n0,2\n-3,1\n", both, "one number with a decimal comma, or two whole numbers"
        ),
        OtherFile("utf16.csv", _columns(",", csv).decode().encode("utf-16"), {}, (1.0, 0.02)),
        OtherFile("units_row.csv", _columns(",", "time,acc", "s,mm/s²"), {}, (0.001, 0.02)),
        OtherFile("units.csv", _columns(",", "Time (SEC),Acceleration (CM/SEC/SEC)"), {}, (GAL, 0.02)),
        OtherFile("inch.csv", _columns(",", "time_us,acc (in/s²)", step=5000, form="%d"), {}, (0.0254, 0.005)),
        OtherFile("volts.csv", _columns(",", "time [s],acc [V]"), {}, "unit 'V' of acc"),
        OtherFile("hash.csv", _columns(",", "% exported", "time [s],acc #1 [g]", more="  # note"), {}, (G, 0.02)),
        OtherFile("savetxt.txt", _columns(" ", "# t [s] acc [g]"), {}, (G, 0.02)),
        OtherFile(
            "clock.csv",
            _text(
                "Timestamp,acc [g]",
                *(
                    f"2000-01-01 10:00:{59.98 + 0.02 * k:05.2f}".replace(":60.", ":59.") + f",{value}"
                    for k, value in enumerate(VALUES[:1])
                ),
                *(f"2000-01-01 10:01:{0.02 * k:05.2f},{value}" for k, value in enumerate(VALUES[1:])),
            ),
            {},
            (G, 0.02),
        ),
        OtherFile(
            "rounded.csv", _columns(",", "t,a [g]", step=1 / 128, form="%.3f"), {"sample_period": 1 / 128}, (G, 1 / 128)
        ),
        OtherFile(
            "counter.txt", _columns(" ", step=1, form="%d"), g, "rises by 1 and states no unit, expected sample_period"
        ),
        OtherFile("counter.txt", _columns(" ", step=1, form="%d"), both, (G, 0.01)),
        OtherFile(
            "gap.txt",
            b"0 1\n.01 1\n.02 1\n.04 1\n.05 1\n.06 1\n",
            g,
            "time step 0.02 s, expected equal steps of 0.01 s",
        ),
        OtherFile("rows.txt", _text(*_fixed(8, 3, 5)), both, (G, 0.01)),
        OtherFile("one_line.txt", _text(*_fixed(8, 3, 8)), both, (G, 0.01)),
        OtherFile("count.txt", _columns(" ", " 8  0.02"), g, (G, 0.02)),
        OtherFile("two_lines.txt", _text("8", "0.02", *map(str, VALUES)), g, (G, 0.02)),
        OtherFile(
            "accuracy.csv",
            _text("time [s],accuracy,gFx [g]", *(f"{0.01 * k:.2f},3,{value}" for k, value in enumerate(VALUES))),
            {},
            "no column named an acceleration, .*channel='gFx'",
        ),
        OtherFile(
            "unused.csv",
            _text(
                '"t [s]","acc [g]","once",',
                *(f"{0.01 * k:.2f},{value},{'x' if not k else ''}," for k, value in enumerate(VALUES)),
            ),
            {},
            (G, 0.01),
        ),
        OtherFile(
            "mistakes.csv",
            _columns(",", csv).replace(b"-1.25", b"x").replace(b"0.125", b""),
            {},
            "line 3: 'x' in acc, .*; line 7: '' in acc$",
        ),
        # arrays
        OtherFile("rows.mat", _mat(q=rows), {**g, "channel": "q"}, (G, 0.02)),
        OtherFile("columns.mat", _mat(q=np.column_stack([*rows, rows[1]])), {**g, "channel": "q_2"}, (G, 0.02)),
        OtherFile(
            "struct.mat", _mat(test={"site": {"ew": np.array(VALUES)}}), {**both, "channel": "test.site.ew"}, (G, 0.01)
        ),
        OtherFile(
            "building.mat",
            _mat(M=np.eye(3), K=2 * np.eye(3), zetas=np.full(3, 0.05)),
            both,
            r"no column named .* K_3 \(3\), zetas \(3\)",
        ),
        OtherFile("text.mat", _columns(" "), g, (G, 0.02)),
        OtherFile(
            "arrays.npz",
            _npz(t=rows[0], acc=rows[1], about=np.array({}, dtype=object)),
            {**g, "channel": "acc"},
            (G, 0.02),
        ),
        # what has no columns
        OtherFile("page.csv", b"<!DOCTYPE html><html></html>", {}, "a web page"),
        OtherFile("pointer.mat", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", {}, "git-LFS"),
        OtherFile("packed.txt", gzip.compress(_columns(" ")), {}, "gzip"),
        OtherFile("sheet.xlsx", b"PK\x03\x04" + bytes(26) + b"xl/workbook.xml", {}, r"Excel workbook \(.xlsx\)"),
        OtherFile("a.h5", b"\x89HDF\r\n\x1a\n" + bytes(600), {}, "HDF5"),
        OtherFile("a.json", b'{"a": [1, 2]}', {}, "JSON"),
        OtherFile("a.mseed", b"000001D X    " + bytes(500), {}, "miniSEED"),
        OtherFile("nothing.txt", b"\n", {}, "empty"),
    ]


def outcome(case: OtherFile, folder: Path) -> str:
    """What is wrong with how a file is read; empty: nothing."""
    path = folder / case.name
    path.write_bytes(case.content)
    try:
        record = read_record(path, **case.given)
    except AbraceError as error:
        message = str(error).replace(str(path), case.name)
        said = isinstance(case.right, str) and re.search(case.right, message) and "\n" not in message
        return "" if said else f"refused: {message}"
    if isinstance(case.right, str):
        return f"read: {record}, expected a refusal: {case.right}"
    factor, period = case.right
    exact = record.acceleration.shape == (8,) and np.allclose(
        record.acceleration, factor * np.array(VALUES), rtol=1e-12
    )
    return (
        "" if exact and abs(record.sample_period / period - 1) < 1e-12 else f"read: {record} {record.acceleration[:3]}"
    )


def verify_files() -> tuple[dict[str, Any], list[Claim]]:
    """How many of the files are read exactly, or refused as they are to be."""
    cases = other_files()
    with tempfile.TemporaryDirectory() as folder:
        wrong = [case.name for case in cases if outcome(case, Path(folder))]
    values = {"small": len(cases), "right": len(cases) - len(wrong), "wrong": wrong}
    return values, [Claim("files of others not read right", len(wrong), 0, "the files")]
