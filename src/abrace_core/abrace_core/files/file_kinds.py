# SPDX-License-Identifier: Apache-2.0
"""What a file is by its first bytes: texts are decoded, other kinds are refused by their names."""

from __future__ import annotations

import re
from typing import Literal

from abrace_core import AbraceError

RECORDS = "the extra `records` (make records, or pip install '.[records]')"
"""What reads seismological and further formats."""
_BINARY = (
    (rb"\x89HDF\r\n\x1a\n", "HDF5", "its arrays saved as .mat (version 7), .npz or a text"),
    (rb"\x1f\x8b", "compressed by gzip", "the file that gunzip gives"),
    (rb"PK\x03\x04.*?(?:xl/|\[Content_Types\])", "an Excel workbook (.xlsx)", "a sheet of it saved as CSV"),
    (rb"PK\x03\x04", "a ZIP archive", "one of the files in it"),
    (rb"\xd0\xcf\x11\xe0", "an Excel workbook (.xls)", "a sheet of it saved as CSV"),
    (rb"BZh\d|\xfd7zXZ|7z\xbc\xaf|Rar!|\x28\xb5\x2f\xfd", "a compressed file", "the file in it"),
    (rb"SQLite format 3", "an SQLite database", "a bag of MCAP, or a text"),
    (rb"%PDF|\x89PNG|\xff\xd8\xff", "a document or picture", "the numbers in it as CSV"),
    (rb"PAR1", "Parquet", "a CSV file"),
    (rb"TDS[mh]", "TDMS of LabVIEW", "its channels exported as CSV (Python's npTDMS reads it)"),
)
_TEXTS = (
    (
        r"\s*LabVIEW Measurement",
        "a measurement file of LabVIEW (.lvm)",
        "its columns as CSV (Python's lvm_read reads it)",
    ),
    (r"version https://git-lfs", "a pointer of git-LFS in place of the file", "`git lfs pull` first"),
    (r"\s*<(?:!doctype|html|head|\?xml[^>]*>\s*<!doctype html)", "a web page in place of the file", "the file itself"),
    (r"\s*<\?xml|\s*<[a-zA-Z]", "XML", "a table of numbers"),
    (r"\s*[\[{]\s*[\"{\[\]}]", "JSON", "a table of numbers, such as CSV"),
)


_SAC_IN_TEXT = re.compile(rb"(?:(?: *[-+.\dE]+){5} *\r?\n){14}(?:(?: *-?\d+){5} *\r?\n){8}")


def seismic_kind(content: bytes) -> str:
    """The seismological format of a file's `content`, such as SAC or miniSEED, or UFF; empty: none of these."""
    if re.match(rb"\d{6}[DRQMV][ \0]", content) or (content[:2] == b"MS" and content[2:3] == b"\x03"):
        return "miniSEED"
    if re.match(rb"K[\x00\x01]\x01[\x00-\x14]", content):
        return "Kinemetrics EVT"
    orders: tuple[Literal["little", "big"], ...] = ("little", "big")
    for order in orders:
        version, samples = (int.from_bytes(content[at : at + 4], order) for at in (304, 316))
        if version in (6, 7) and samples and (len(content) - 632 - 176 * (version == 7)) in (4 * samples, 8 * samples):
            return "SAC"
    if b"-12345" in content[:2000] and _SAC_IN_TEXT.match(content[:4000]):
        return "SAC"
    if content[:2] in (b"\x55\x3a", b"\x3a\x55"):
        return "SEG-2"
    if re.match(rb"WID[12]", content):
        return "GSE"
    if re.match(rb"\s*-1\r?\n\s*(?:58b?|151|164)\b", content):
        return "UFF (universal file)"
    return ""


def decoded(content: bytes, source: str) -> str:
    """The text in the `content` of a file, which errors call `source`, with lines that end with a newline.

    Its encoding is UTF-8, UTF-16, UTF-32, or else taken for ISO 8859-1.

    Raises
    ------
    AbraceError
        If it is empty, no text, or another thing in its place: what, and what was expected.
    """
    if kind := seismic_kind(content):
        raise AbraceError(f"{source}: {kind}, expected columns of numbers; load_record reads it with {RECORDS}")
    for pattern, kind, expected in _BINARY:
        if re.match(pattern, content[:4000], re.DOTALL):
            raise AbraceError(f"{source}: {kind}, expected {expected}")
    encoding = "utf-8-sig"
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encoding = "utf-32" if content[:4] in (b"\xff\xfe\0\0", b"\0\0\xfe\xff") else "utf-16"
    elif b"\0" in content[:400]:
        even, odd = (content[k:400:2].count(0) for k in (0, 1))
        if min(even, odd) or max(even, odd) < 0.4 * len(content[:400]) / 2:
            raise AbraceError(f"{source}: binary, expected a text, MATLAB or NumPy file, or a bag")
        encoding = "utf-16-le" if odd else "utf-16-be"
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError:
        text = content.decode("latin-1")  # of Windows, in which a unit may be written as m/s²
    # DOS, and the old strong-motion files from it, end a text with the character 26
    text = text.replace("\r\n", "\n").replace("\r", "\n").rstrip("\x1a\n\t \0")
    if not text:
        raise AbraceError(f"{source}: empty, expected numbers")
    if "\0" in text:
        raise AbraceError(f"{source}: binary, expected a text, MATLAB or NumPy file, or a bag")
    for form, kind, expected in _TEXTS:
        if re.match(form, text, re.IGNORECASE):
            raise AbraceError(f"{source}: {kind}, expected {expected}")
    return text
