# SPDX-License-Identifier: Apache-2.0
"""Formats that the extra `records` reads: ObsPy has SAC, miniSEED, Kinemetrics, SEG-2, GSE; pyuff UFF 58."""

from __future__ import annotations

import importlib
import importlib.util
import warnings
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from abrace_core import AbraceError
from abrace_core.files.file_kinds import RECORDS
from abrace_plant.records.reading import Reading, checked_reading

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from abrace_plant.records.asked import Asked

_UFF_MOTIONS = {8: "displacement", 11: "velocity", 12: "acceleration", 13: "excitation force", 9: "reaction force"}
_SAC_MOTIONS = {6: "displacement", 7: "velocity", 50: "volts"}


class _Trace(NamedTuple):
    name: str
    values: NDArray[Any]
    sample_period: float
    unit: str | None
    motion: str


def read_by_library(path: Path, kind: str, source: str, asked: Asked) -> Reading:
    """Read what is `asked` of a file at `path` of this `kind`, as `seismic_kind` has it; errors call it `source`.

    Raises
    ------
    AbraceError
        If its library is not installed, the file is of another motion, in counts, or has several channels.
    """
    library = "pyuff" if kind.startswith("UFF") else "obspy"
    if importlib.util.find_spec(library) is None:
        raise AbraceError(f"{source}: {kind}, which is read with {RECORDS}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            traces = _of_pyuff(path) if library == "pyuff" else _of_obspy(path)
    except Exception as error:  # both raise almost any exception for a damaged file
        raise AbraceError(f"{source}: {kind}, not read: {' '.join(str(error).split())[:80]}") from error
    names = [trace.name for trace in traces]
    once = len(set(names)) == len(names)  # a gap divides a channel
    listed = names if once else [f"{i} ({name})" for i, name in enumerate(names, 1)]
    keys = names if once else [str(i) for i in range(1, len(names) + 1)]
    found = [trace for key, trace in zip(keys, traces, strict=True) if asked.channel in (None, key)]
    if len(found) != 1:
        raise AbraceError(f"{source}: {kind}, {len(traces)} channels, expected {asked.one_of(listed)}")
    (trace,) = found
    if trace.motion not in ("", "acceleration"):
        raise AbraceError(f"{source}: {kind}, {trace.name} is a {trace.motion}, expected an acceleration")
    if trace.values.dtype.kind not in "f":
        what = "counts of the digitiser, expected it in units of acceleration (ObsPy's remove_response)"
        raise AbraceError(f"{source}: {kind}, {trace.name}: {what}")

    def error_at(message: str, sample: int | None) -> AbraceError:
        return AbraceError(f"{source}{'' if sample is None else f', sample {sample + 1}'}: {message}")

    values = np.ma.filled(trace.values, np.nan)
    return checked_reading(values, error_at, unit=trace.unit, sample_period=trace.sample_period, chosen=trace.name)


def _of_obspy(path: Path) -> list[_Trace]:
    read = importlib.import_module("obspy").read
    traces = []
    for trace in read(str(path)):
        code = trace.stats.get("sac", {}).get("idep")
        motion = _SAC_MOTIONS.get(code, "acceleration" if code == 8 else "")
        # ObsPy multiplies the counts of a Kinemetrics file by the sensors' sensitivities
        unit = "m/s^2" if trace.stats.get("_format") == "KINEMETRICS_EVT" else None
        traces.append(_Trace(trace.stats.channel or trace.id, trace.data, float(trace.stats.delta), unit, motion))
    return traces


def _of_pyuff(path: Path) -> list[_Trace]:
    pyuff = importlib.import_module("pyuff")
    traces = []
    for block in np.atleast_1d(pyuff.UFF(str(path)).read_sets()):
        if block.get("type") != 58 or block.get("func_type") != 1 or not block.get("abscissa_spacing"):
            continue
        name = f"{block['rsp_ent_name'].strip()}:{block['rsp_node']}:{block['rsp_dir']}"
        unit = (block.get("ordinate_axis_units_lab") or "").strip()
        motion = _UFF_MOTIONS.get(int(block.get("ordinate_spec_data_type") or 0), "")
        traces.append(_Trace(name, np.asarray(block["data"]), float(block["abscissa_inc"]), unit or None, motion))
    return traces
