# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from abrace_core import AbraceError
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


def test_csv_without_times_or_unit_takes_them_from_the_caller(tmp_path):
    path = written(tmp_path, "quake.csv", "\ufeffacceleration\n0.5\n-0.5\n".encode())
    record = read_record(path, unit="m/s^2", sample_period=0.01)
    assert (record.sample_period, record.acceleration.tolist()) == (0.01, [0.5, -0.5])


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.at2", "PEER STRONG MOTION DATABASE RECORD\n", "1 lines, expected PEER's four lines of header"),
        (
            "a.at2",
            at2(units="VELOCITY TIME SERIES IN UNITS OF CM/S"),
            "line 3: PEER's .*expected the file of the acceleration .AT2., in units of G",
        ),
        ("a.at2", at2(sizes="7 values at 0.02 s"), "line 4: .*expected NPTS= and DT="),
        ("a.at2", at2(sizes="NPTS= 7, DT= 0.0 SEC"), "line 4: DT 0 s, expected more than 0"),
        ("a.at2", at2(sizes="NPTS= 8, DT= .02 SEC"), "7 values, expected NPTS = 8"),
        ("a.at2", at2(values=" .1 .2\n .3 nan .1 .1 .1\n"), "line 6: 'nan', expected a finite number"),
        ("a.txt", "", "empty"),
        ("a.txt", "0.1\n0.2\nabc\n0.3\nx\n", "line 3: 'abc', expected a finite number; line 5: 'x'$"),
        ("a.txt", "0.1\n0.2 0.3\n", "line 2: 2 columns, expected 1 as before"),
        ("a.txt", ".1 1 2\n.3 1 2\n.2 1 2\n", "expected channel as one of 1, 2, 3, such as channel='1'"),
        ("a.txt", b"\x93NUMPY\x01\n\xff\xfe 5\n", "format version"),
        ("a.csv", "0.0,0.1\n0.01,0.2\n", "no unit in the file, expected unit='g', or one of m/s"),
        ("a.csv", "time [s],acc1 [g],acc2 [g]\n0,1,1\n1,1,1\n", "2 columns named an acceleration, .*channel='acc1'"),
        ("a.csv", "time [s],acc [g]\n0,.1\n1\n", "line 3: 1 columns, expected 2 as before"),
    ],
)
def test_malformed_file_gives_one_line_that_names_file_and_line(tmp_path, name, text, message):
    path = written(tmp_path, name, text)
    columns = name == "a.csv" or text[1:2] == " "
    with pytest.raises(AbraceError, match=message) as caught:
        read_record(path, unit=None if name == "a.csv" else "g", sample_period=None if columns else 0.02)
    assert str(caught.value).startswith(f"ground motion {path}")
    assert "\n" not in str(caught.value)


NORTH_AND_EAST = "time [s],acc_ns [g],acc_ew [cm/s^2],Drift (m)\n0,1,2,3\n0.1,4,5,6\n"


@pytest.mark.parametrize(
    ("channel", "message"),
    [
        (None, "2 columns named an acceleration, expected channel as one of acc_ns .g., acc_ew .cm/s.2., Drift .m."),
        ("acc_up", "no column 'acc_up', expected channel as one of acc_ns"),
        ("time", "no column 'time', expected channel as one of acc_ns"),
        ("drift", "unit 'm' of Drift, expected an acceleration's"),
    ],
)
def test_csv_with_several_accelerations_wants_the_name_of_one(tmp_path, channel, message):
    with pytest.raises(AbraceError, match=message):
        read_record(written(tmp_path, "two.csv", NORTH_AND_EAST), channel=channel)


WAVE = [0.1, -0.2, 0.3, 0.25, -0.05, 0.0, 0.01, 0.02]


def headed(header: str) -> str:
    return f"{header}\n" + "".join(f"{value}\n" for value in WAVE)


@pytest.mark.parametrize(
    ("header", "unit", "factor"),
    [
        ("# accelerations in g, dt = 0.005", "g", G),
        ("# Acceleration [g], sampling rate 200 Hz", "g", G),
        ("% acceleration (cm/s2); time step 0.005 s", "cm/s^2", 0.01),
        ("acc in m/s^2, dt=0.005 s", "m/s^2", 1.0),
        ("# acceleration, g; dt: 5 ms", "g", G),
        ("# values are in gal\n# sampled at 200 Hz", "cm/s^2", 0.01),
        ("# ground acceleration in m/s/s; sample interval = 0.005 s", "m/s^2", 1.0),
        ("# Acceleration time history in units of g\n# NPTS= 8, DT= 0.005 SEC", "g", G),
        ("# delta = 0.005, unit = mg", "mg", 1e-3 * G),
    ],
)
def test_unit_and_step_in_a_sentence_above_the_values_are_read_and_others_refused(tmp_path, header, unit, factor):
    path = written(tmp_path, "quake.txt", headed(header))
    for record in (read_record(path), read_record(path, unit, 0.005)):
        assert record.sample_period == pytest.approx(0.005, rel=1e-9)
        np.testing.assert_allclose(record.acceleration, factor * np.array(WAVE), rtol=1e-12)
    with pytest.raises(AbraceError, match=r"the file states .*, unit in/s\^2 was given"):
        read_record(path, unit="in/s^2")
    with pytest.raises(AbraceError, match=r"sample period 0\.005 s, 0\.02 s was given"):
        read_record(path, sample_period=0.02)


@pytest.mark.parametrize(
    "header",
    ["# peak acceleration in g: 0.3", "# maximum acceleration (g) 0.3", "# filtered, accelerations in ground floor"],
)
def test_the_unit_of_another_number_in_the_header_is_not_that_of_the_values_and_the_line_is_shown(tmp_path, header):
    path = written(tmp_path, "quake.txt", headed(header))
    with pytest.raises(AbraceError) as refused:
        read_record(path)
    assert "no unit in the file" in str(refused.value)
    assert f"(it begins with {header[:60]!r})" in str(refused.value)


@pytest.mark.parametrize("header", ["time interval 12 - 40 s", "time interval 12-40 s", "dt 1 to 5 ms"])
def test_a_range_in_the_header_is_no_time_step(tmp_path, header):
    path = written(tmp_path, "quake.txt", headed(f"# of the motion\n# {header}\n# station 5"))
    assert read_record(path, "g", 0.01).sample_period == 0.01


@pytest.mark.parametrize("name", ["quake.acc", "quake.txt", "quake", "quake.csv"])
def test_peers_format_is_known_by_its_content_whatever_the_name(tmp_path, name):
    path = written(tmp_path, name, at2())
    assert read_record(path).acceleration.tolist() == pytest.approx([G * each for each in VALUES])
    with pytest.raises(AbraceError, match=r"states g, unit m/s\^2 was given"):
        read_record(path, unit="m/s^2")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            "LabVIEW Measurement\t\nSeparator\tTab\n***End_of_Header***\t\n\nChannels\t1\nX_Value\tacc\n\t0.1\n",
            r"a measurement file of LabVIEW \(\.lvm\), expected its columns as CSV \(Python's lvm_read reads it\)",
        ),
        (b"TDSm\x0e\0\0\0" + bytes(60), r"TDMS of LabVIEW, expected its channels exported as CSV \(Python's npTDMS"),
        (b"TDSh\x0e\0\0\0" + bytes(60), "TDMS of LabVIEW"),
    ],
)
@pytest.mark.parametrize("name", ["quake.lvm", "quake.tdms", "quake.txt"])
def test_files_of_labview_are_named_with_what_to_do(tmp_path, name, content, message):
    with pytest.raises(AbraceError, match=message):
        read_record(written(tmp_path, name, content), unit="g", sample_period=0.01)
