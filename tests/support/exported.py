# SPDX-License-Identifier: Apache-2.0
"""Exported controllers, run: C99 sources through ctypes, a co-simulation unit through FMPy."""

from __future__ import annotations

import ctypes
import os
import shlex
import subprocess
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2", "-fPIC", "-shared")


def compiled(folder: Path) -> Path:
    """The library of the sources in a folder, compiled with every warning an error."""
    library = folder / "controller.so"
    sources = [str(folder / name) for name in ("controller.c", "constants.c")]
    subprocess.run([*shlex.split(os.environ.get("CC", "cc")), *STRICT, "-o", str(library), *sources, "-lm"], check=True)
    return library


class InC:
    """The C controller of a library, with `states` states and `commands` commands."""

    def __init__(self, library: Path, states: int, commands: int) -> None:
        class Controller(ctypes.Structure):
            _fields_ = (
                ("force", ctypes.c_double * commands),
                ("stopped", ctypes.c_int),
                ("state", ctypes.c_double * states),
                ("initial", ctypes.c_double * commands),
                ("samples", ctypes.c_long),
                ("held", ctypes.c_long),
                *((name, ctypes.c_double * commands) for name in ("law", "wanted", "first", "more")),
                ("next", ctypes.c_double * states),
            )

        self._library = ctypes.CDLL(str(library))
        self._controller = Controller()

    def start(self, acting: Iterable[float]) -> None:
        """Begin from the force that acts [N]."""
        acting = np.array([*acting], dtype=np.float64)
        self._library.abrace_controller_start(ctypes.byref(self._controller), _pointer(acting))

    def step(self, measured: Array) -> tuple[list[float], bool]:
        """The forces [N] that answer a sample, and whether the controller is stopped."""
        values = np.ascontiguousarray(measured, dtype=np.float64)
        stopped = self._library.abrace_controller_step(ctypes.byref(self._controller), _pointer(values))
        return list(self._controller.force), bool(stopped)

    def answers(self, measured: Array) -> Array:
        """(samples, commands) forces [N] that answer (samples, measured) values from rest."""
        self.start(np.zeros(len(self._controller.force)))
        return np.array([self.step(values)[0] for values in measured])


def unit_answers(
    unit: Path, names: tuple[str, ...], commands: tuple[str, ...], measured: Array, period: float
) -> Array:
    """(samples, commands) forces [N] of a co-simulation unit that is given (samples, measured) values from rest."""
    from fmpy import extract, read_model_description
    from fmpy.fmi2 import FMU2Slave

    unit = unit.resolve()
    described = read_model_description(str(unit), validate=True)
    references = {variable.name: variable.valueReference for variable in described.modelVariables}
    slave = FMU2Slave(
        guid=described.guid,
        unzipDirectory=extract(str(unit), str(unit.parent / f"{unit.stem}_extracted")),
        modelIdentifier=described.coSimulation.modelIdentifier,
    )
    slave.instantiate()
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    inputs, outputs = ([references[name] for name in which] for which in (names, commands))
    found = np.empty((len(measured), len(commands)))
    for k, values in enumerate(measured):
        slave.setReal(inputs, values.tolist())
        slave.doStep(k * period, period)
        found[k] = slave.getReal(outputs)
    slave.terminate()
    slave.freeInstance()
    return found


def _pointer(values: Array) -> ctypes.Array | object:
    return values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
