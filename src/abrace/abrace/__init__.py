# SPDX-License-Identifier: Apache-2.0
"""Tests of an actively braced building: read, identify, design, simulate, validate; without ROS.

For example::

    import abrace
    found = abrace.identify(table="bags/table_noise", command="bags/command_noise")
    designed = abrace.design(found, "lqg3")
    run = abrace.simulate("ncree_three_storey", "el_centro", controller=designed, peak_acceleration=0.98)
    run.plot()

Rigs, records, weights and models are given by name, by file, or as objects.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from abrace_core import __version__ as __version__
from abrace_core import public

if TYPE_CHECKING:
    from abrace.interactive.controllers import design
    from abrace.interactive.data import identify_ambient, identify_data
    from abrace.interactive.identification import identify, transfer_functions
    from abrace.interactive.laboratory import characterize, load_record, load_rig, read_run
    from abrace.interactive.models import discretize, margins, save_mat, save_model
    from abrace.interactive.simulation import simulate
    from abrace.interactive.studies import explore, fragility
    from abrace.interactive.validation import validate
    from abrace_bags import read_runs
    from abrace_core import AbraceError
    from abrace_core.model.controller_file import Controller, load_controller
    from abrace_core.model.linear_model import LinearModel, load_model
    from abrace_core.model.run import Run
    from abrace_lqg.weights import Weights
    from abrace_plant.records.record import Record
    from abrace_plant.rig.model import Rig
    from abrace_sysid.recorded.test import Test

_public, __dir__ = public(
    __name__,
    {
        "abrace.interactive.controllers": "design",
        "abrace.interactive.data": "identify_ambient identify_data",
        "abrace.interactive.identification": "identify transfer_functions",
        "abrace.interactive.laboratory": "characterize load_record load_rig read_run",
        "abrace.interactive.models": "discretize margins save_mat save_model",
        "abrace.interactive.simulation": "simulate",
        "abrace.interactive.studies": "explore fragility",
        "abrace.interactive.validation": "validate",
        "abrace_bags": "read_runs",
        "abrace_core.model.controller_file": "Controller load_controller",
        "abrace_core": "AbraceError",
        "abrace_core.model.linear_model": "LinearModel load_model",
        "abrace_core.model.run": "Run",
        "abrace_lqg.weights": "Weights",
        "abrace_plant.records.record": "Record",
        "abrace_plant.rig.model": "Rig",
        "abrace_sysid.recorded.test": "Test",
    },
)
"""Imported at first use, so that the `abrace` command starts without these imports."""

_OTHER_NAMES = {
    "bode": "MODEL.bode()",
    "c2d": "discretize",
    "compare": "MODEL.compare(test)",
    "lqg": "design",
    "lqr": "design",
    "lsim": "simulate",
    "n4sid": "identify",
    "read_bag": "read_run",
    "ss": "LinearModel",
    "step": "MODEL.step()",
    "tfest": "identify",
    "tfestimate": "transfer_functions",
}
"""What users of MATLAB look for, and where it is."""

__all__ = [
    "AbraceError",
    "Controller",
    "LinearModel",
    "Record",
    "Rig",
    "Run",
    "Test",
    "Weights",
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
    "margins",
    "read_run",
    "read_runs",
    "save_mat",
    "save_model",
    "simulate",
    "transfer_functions",
    "validate",
]


def __getattr__(name: str) -> Any:
    if name in _OTHER_NAMES:
        raise AttributeError(f"module 'abrace' has no attribute {name!r}, expected {_OTHER_NAMES[name]}")
    if name in __all__:
        importlib.import_module("abrace.interactive.plots")
    return _public(name)
