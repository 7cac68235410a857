# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from abrace_core.errors import AbraceError
from abrace_plant.records.files import read_record

G = 9.80665
VALUES = [0.1, -0.2, 0.3, 0.25, -0.05, 0.0, 0.01]
AT2_SIZES = [
    "NPTS =   7 , DT =   .020 SEC ,                 ",
    "NPTS=   7, DT=   .0200 SEC,",
    "NPTS=   7, DT=   .0200 SEC",
    "  7   0.0200  NPTS, DT",
]


def at2(sizes: str = AT2_SIZES[1], units: str = "ACCELERATION TIME SERIES IN UNITS OF G", values: str = "") -> str:
    rows = values or "  .1000000E+00  -.2000000E+00   .3000000E+00   .2500000E+00  -.0500000E+00\n  0.0  .1E-01\n"
    return f"PEER NGA STRONG MOTION DATABASE RECORD\nSomewhere, 1/1/1999, Station, 180\n{units}\n{sizes}\n{rows}"


def written(folder, name, text):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize("sizes", AT2_SIZES)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_at2_is_read_in_every_form_of_its_header(tmp_path, sizes, end):
    path = written(tmp_path, "quake.AT2", at2(sizes).replace("\n", end))
    record = read_record(path)
    assert record.name == "quake"
    assert record.sample_period == 0.02
    np.testing.assert_allclose(record.acceleration, np.array(VALUES) * G, rtol=1e-15)


def test_at2_with_the_old_units_line_and_a_foreign_station_name_is_read(tmp_path):
    text = at2(units="ACCELERATION TIME HISTORY IN UNITS OF G. FILTER POINTS: HP=0.1 Hz LP=40.0 Hz")
    path = written(tmp_path, "old.at2", text.replace("Station", "Estación").encode("latin-1"))
    assert read_record(str(path), unit="g").acceleration[2] == pytest.approx(0.3 * G)


def test_one_column_takes_its_period_and_unit_from_the_caller(tmp_path):
    path = written(tmp_path, "one.txt", "# made here\n" + "\n".join(f"{value}  # note" for value in VALUES) + "\n\n")
    record = read_record(path, unit="cm/s^2", sample_period=0.005)
    assert record.sample_period == 0.005
    np.testing.assert_allclose(record.acceleration, np.array(VALUES) / 100, rtol=1e-15)


def test_two_columns_give_times_and_accelerations(tmp_path):
    rows = "".join(f"{10 + i / 256:.4f}\t{value}\n" for i, value in enumerate(VALUES))
    record = read_record(written(tmp_path, "two.dat", rows), unit="g")
    assert record.sample_period == pytest.approx(1 / 256, rel=0.005)
    np.testing.assert_allclose(record.acceleration, np.array(VALUES) * G, rtol=1e-15)


@pytest.mark.parametrize(
    ("header", "factor"),
    [
        ("time [s],acceleration [m/s^2]", 1.0),
        ("time,acc (g)", G),
        ("t [s], station, a [ cm/s^2 ]", 0.01),
        ("time [sec],acc [GAL]", 0.01),
        ("time,acc (cm/sec2)", 0.01),
        ("time,acc (cm/sec/sec)", 0.01),
        ("time,acc (m/s²)", 1.0),
        ('"Time (s)","Acceleration (g)"', G),
    ],
)
def test_csv_takes_units_from_its_header(tmp_path, header, factor):
    middle = ",7" * (header.count(",") - 1)
    rows = "".join(f"{0.01 * i:.2f}{middle},{value}\n" for i, value in enumerate(VALUES))
    record = read_record(written(tmp_path, "quake.csv", "# exported\n\ufeff".strip("\ufeff") + header + "\n" + rows))
    assert record.sample_period == pytest.approx(0.01, rel=1e-12)
    np.testing.assert_allclose(record.acceleration, np.array(VALUES) * factor, rtol=1e-15)


def test_csv_of_windows_has_its_units(tmp_path):
    path = written(tmp_path, "quake.csv", "# Prüfstand\ntime [s],acc [m/s²]\n0,0.5\n1,-0.5\n".encode("latin-1"))
    assert read_record(path).acceleration.tolist() == [0.5, -0.5]


def test_csv_without_times_or_unit_takes_them_from_the_caller(tmp_path):
    path = written(tmp_path, "quake.csv", "\ufeffacceleration\n0.5\n-0.5\n".encode())
    record = read_record(path, unit="m/s^2", sample_period=0.01)
    assert (record.sample_period, record.acceleration.tolist()) == (0.01, [0.5, -0.5])


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.at2", "one\ntwo\n", "2 lines, expected PEER's four lines of header"),
        (
            "a.at2",
            at2(units="VELOCITY TIME SERIES IN UNITS OF CM/S"),
            "line 3: .*expected an acceleration in units of G",
        ),
        ("a.at2", at2(units="ACCELERATION TIME SERIES IN UNITS OF GAL"), "line 3: "),
        ("a.at2", at2(units="ACCELERATION TIME SERIES"), "line 3: "),
        ("a.at2", at2(sizes="7 values at 0.02 s"), "line 4: .*expected NPTS= and DT="),
        ("a.at2", at2(sizes="NPTS= 7, DT= 0.0 SEC"), "line 4: DT 0 s, expected more than 0"),
        ("a.at2", at2(sizes="NPTS= 7, DT= 1e SEC"), "line 4: '1e', expected a finite number"),
        ("a.at2", at2(sizes="NPTS= 8, DT= .02 SEC"), "7 values, expected NPTS = 8"),
        ("a.at2", at2(sizes="NPTS= 6, DT= .02 SEC"), "7 values, expected NPTS = 6"),
        ("a.at2", at2(values=" .1 .2\n .3 nan .1 .1 .1\n"), "line 6: 'nan', expected a finite number"),
        ("a.at2", at2(values=" .1 .2 .3\n .1 .1 .1-.2\n"), "line 6: '.1-.2', expected a finite number"),
        ("a.at2", at2(sizes="NPTS= 1, DT= .02 SEC", values=" .1\n"), "1 values, expected at least 2"),
        ("a.txt", "", "empty"),
        ("a.txt", "# nothing\n\n", "empty"),
        ("a.txt", "0.1\n0.2\nabc\n", "line 3: 'abc', expected a finite number"),
        ("a.txt", "0,00 0,1\n0,01 0,2\n", "line 1: '0,00', expected a finite number with a decimal point"),
        ("a.txt", "0.1\n1_0\n", "line 2: '1_0', expected a finite number"),
        ("a.txt", "0.1\n0.2 0.3\n", "line 2: 2 columns, expected 1 as before"),
        ("a.txt", "0 1 2\n", "line 1: 3 columns, expected one .* or two"),
        ("a.txt", "0.1\n", "1 values, expected at least 2"),
        ("a.txt", "0 .1\n.01 .2\n.02 inf\n", "line 3: 'inf'"),
        (
            "a.txt",
            "0 1\n.01 1\n.02 1\n.04 1\n.05 1\n.06 1\n",
            "line 4: time step 0.02 s, expected equal steps of 0.01 s",
        ),
        ("a.txt", "0 1\n.01 1\n.02 1\n.02 1\n.03 1\n", "line 4: time step 0 s"),
        ("a.txt", "0 1\n-.01 1\n-.02 1\n", "line 3: times that do not increase"),
        ("a.txt", b"\x93NUMPY\x01\n\xff\xfe 5\n", "line 1: .*expected a finite number"),
        ("a.csv", "0.0,0.1\n0.01,0.2\n", "line 1: '0.0,0.1', expected names such as"),
        ("a.csv", "time [s],velocity [m/s]\n0,1\n1,1\n", "line 1: .*expected names such as"),
        ("a.csv", "time [s],acc1 [g],acc2 [g]\n0,1,1\n1,1,1\n", "line 1: .*one of them an acceleration"),
        ("a.csv", "time [s];acceleration [g]\n0;1\n1;1\n", "line 1: "),
        ("a.csv", "time [ms],acc [g]\n0,1\n1,1\n", "line 1: unit 'ms' of the time, expected s"),
        (
            "a.csv",
            "time [s],acc [ft/s^2]\n0,1\n1,1\n",
            "line 1: unit 'ft/s\\^2' .*expected one of g, m/s\\^2, cm/s\\^2",
        ),
        ("a.csv", "time [s],acc [g]\n0,1\n1\n", "line 3: 1 columns, expected 2 as in the header"),
        ("a.csv", "time [s],acc [g]\n0,1\n1,\n", "line 3: '', expected a finite number"),
        ("a.csv", "time [s],acc [g]\n", "0 values"),
    ],
)
def test_malformed_file_gives_one_line_that_names_file_and_line(tmp_path, name, text, message):
    path = written(tmp_path, name, text)
    with pytest.raises(AbraceError, match=message) as caught:
        read_record(path, unit=None if name == "a.csv" else "g", sample_period=None if " 1\n" in str(text) else 0.02)
    assert str(caught.value).startswith(f"ground motion {path}")
    assert "\n" not in str(caught.value)


NORTH_AND_EAST = "time [s],acc_ns [g],acc_ew [cm/s^2],Drift (m)\n0,1,2,3\n0.1,4,5,6\n"


@pytest.mark.parametrize(("channel", "expected"), [("acc_ns", [G, 4 * G]), (" ACC_EW", [0.02, 0.05])])
def test_csv_with_several_accelerations_is_read_by_the_name_of_one(tmp_path, channel, expected):
    record = read_record(written(tmp_path, "two.csv", NORTH_AND_EAST), channel=channel)
    np.testing.assert_allclose(record.acceleration, expected, rtol=1e-15)


@pytest.mark.parametrize(
    ("channel", "message"),
    [
        (None, "line 1: .*or channel as one of acc_ns, acc_ew"),
        ("acc_up", "line 1: .*expected one column 'acc_up'"),
        ("time", "line 1: .*expected one column 'time'"),
        ("drift", "line 1: unit 'm' of the acceleration"),
    ],
)
def test_csv_with_several_accelerations_wants_the_name_of_one(tmp_path, channel, message):
    with pytest.raises(AbraceError, match=message):
        read_record(written(tmp_path, "two.csv", NORTH_AND_EAST), channel=channel)


@settings(max_examples=50)
@given(
    st.lists(st.floats(-20.0, 20.0).map(lambda value: round(value, 9)), min_size=2, max_size=40),
    st.sampled_from(["at2", "csv", "txt"]),
)
def test_what_is_written_is_read_within_the_printed_resolution(tmp_path_factory, values, ending):
    if ending == "at2":
        rows = [values[i : i + 5] for i in range(0, len(values), 5)]
        text = at2(
            f"NPTS= {len(values)}, DT= .0050 SEC,", values="\n".join("".join(f"{v:15.7E}" for v in r) for r in rows)
        )
        resolution = 5.1e-8
    elif ending == "csv":
        text = "t,acc [g]\n" + "".join(f"{0.005 * i:.3f},{v:.9e}\n" for i, v in enumerate(values))
        resolution = 5.1e-10
    else:
        text = "".join(f"{0.005 * i:.3f} {v:.17g}\n" for i, v in enumerate(values))
        resolution = 1e-15
    folder = tmp_path_factory.mktemp("round")
    record = read_record(written(folder, f"a.{ending}", text), unit="g")
    assert record.sample_period == pytest.approx(0.005, rel=1e-9)
    np.testing.assert_allclose(record.acceleration, np.array(values) * G, rtol=2 * resolution, atol=0)
