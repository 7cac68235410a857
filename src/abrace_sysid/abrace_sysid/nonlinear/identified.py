# SPDX-License-Identifier: Apache-2.0
"""Nonlinear elements of a rig, estimated from the tests of its identification."""

from __future__ import annotations

from typing import TYPE_CHECKING

from abrace_core import signals
from abrace_sysid.nonlinear.elements import OF_STOREYS, UNITS, Element, Nonlinearity
from abrace_sysid.nonlinear.estimation import find_elements
from abrace_sysid.validity.mechanics import floor_masses
from abrace_sysid.validity.motion import Motion

if TYPE_CHECKING:
    from collections.abc import Collection

    from abrace_sysid.fitting.options import IdentificationOptions
    from abrace_sysid.identification import Identification

SHOWN_BY = {"friction", "backlash"}
"""Causes named by the validity checks that start a search for nonlinear elements."""


def elements_of_tests(
    found: Identification, options: IdentificationOptions, causes: Collection[str]
) -> Nonlinearity | None:
    """Friction, joints, deadband, backlash and seals that the tests of an identification show; None: nothing.

    Parameters
    ----------
    found
        The identification.
    options
        Options of the identification.
    causes
        Causes named by the validity checks. Elements are searched only if friction or backlash is among them, and if
        the sensors of all floors and the load cells respond.
    """
    floors, groups = found.table.runs[0].floors, found.table.runs[0].groups
    wanted = signals.response_names(floors, groups)
    if not SHOWN_BY & set(causes) or set(wanted) - set(found.model.outputs):
        return None
    options = options.of_tests(found.table.runs, found.command.runs)
    tests = {run.source: (run, options.table_band) for run in found.table.runs}
    tests |= {run.source: (run, options.command_band) for data in found.commands for run in data.runs}
    masses = floor_masses([(Motion.of(run, band[1]), options.table_band) for run, band in tests.values()])
    modes = sorted(float(abs(pole)) for pole in found.poles.building if pole.imag > 0)
    if len(masses) < floors or len(modes) < floors:
        return None
    places = {kind: range(1, 1 + (floors if kind in OF_STOREYS else groups)) for kind in UNITS}
    candidates = tuple(Element(kind, place) for kind, numbers in places.items() for place in numbers)
    shown = Nonlinearity(candidates, tuple(float(masses[floor]) for floor in range(1, floors + 1)), tuple(modes))
    shown = find_elements(found.model, list(tests.values()), shown)
    return shown if shown.elements else None
