# SPDX-License-Identifier: Apache-2.0
"""Tests of an actively braced building: read, identify, design, simulate, validate; without ROS.

    import abrace

    found = abrace.identify(table="bags/table_noise", command="bags/command_noise")
    designed = abrace.design(found, "lqg3")
    run = abrace.simulate("ncree_three_storey", "el_centro", controller=designed, peak_acceleration=0.98)
    run.plot()

Rigs, records, weights and models are given by name, by file, or as objects. The rest of this package runs whole tests:
nodes as processes, campaigns, reports, the `abrace` command.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from abrace.interactive.controllers import design
    from abrace.interactive.data import identify_ambient, identify_data
    from abrace.interactive.exploration import explore
    from abrace.interactive.fragility import fragility
    from abrace.interactive.identification import identify
    from abrace.interactive.laboratory import characterize, load_record, load_rig, read_run
    from abrace.interactive.models import discretize, save_model
    from abrace.interactive.simulation import simulate
    from abrace.interactive.validation import validate
    from abrace_bags import read_runs
    from abrace_core.controller_file import Controller, load_controller
    from abrace_core.errors import AbraceError
    from abrace_core.linear_model import LinearModel, load_model
    from abrace_core.run import Run
    from abrace_plant.records.record import Record
    from abrace_plant.rig.model import Rig

_MODULES = {
    "abrace.interactive.controllers": ("design",),
    "abrace.interactive.data": ("identify_ambient", "identify_data"),
    "abrace.interactive.exploration": ("explore",),
    "abrace.interactive.fragility": ("fragility",),
    "abrace.interactive.identification": ("identify",),
    "abrace.interactive.laboratory": ("characterize", "load_record", "load_rig", "read_run"),
    "abrace.interactive.models": ("discretize", "save_model"),
    "abrace.interactive.simulation": ("simulate",),
    "abrace.interactive.validation": ("validate",),
    "abrace_bags": ("read_runs",),
    "abrace_core.controller_file": ("Controller", "load_controller"),
    "abrace_core.errors": ("AbraceError",),
    "abrace_core.linear_model": ("LinearModel", "load_model"),
    "abrace_core.run": ("Run",),
    "abrace_plant.records.record": ("Record",),
    "abrace_plant.rig.model": ("Rig",),
}
"""Modules of the public names, imported at first use, so that the `abrace` command starts without these imports."""

__all__ = [
    "AbraceError",
    "Controller",
    "LinearModel",
    "Record",
    "Rig",
    "Run",
    "characterize",
    "design",
    "discretize",
    "explore",
    "fragility",
    "identify",
    "identify_ambient",
    "identify_data",
    "load_controller",
    "load_model",
    "load_record",
    "load_rig",
    "read_run",
    "read_runs",
    "save_model",
    "simulate",
    "validate",
]


def __getattr__(name: str) -> Any:
    for module, names in _MODULES.items():
        if name in names:
            return getattr(importlib.import_module(module), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
