# SPDX-License-Identifier: Apache-2.0
"""A controller as C99: the law of the node `controller` with its limits, without a heap, for a target computer.

`controller.h` and `controller.c` are the same for every controller, `constants.h` and `constants.c` are made from it.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from abrace_core import AbraceError
from abrace_core.files.writing import write_text
from abrace_core.safety.command_guard import CommandGuard
from abrace_core.safety.rig_safety import RAMP_TIME

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.model.controller_file import Controller
    from abrace_core.model.linear_model import LinearModel

FIXED = ("controller.h", "controller.c")
"""Sources that do not depend on the controller."""
CONSTANTS = """\
/* Controller {name}, written by abrace.
 * Made from: {model}
 * Weights: {weights}
 * Predicted: {margins}
 *
 * Measured values, in this order:
{measured}
 * Commands, in this order; of a rig the force of one brace of each group:
{commands}
 */
#ifndef ABRACE_CONSTANTS_H
#define ABRACE_CONSTANTS_H

#define ABRACE_STATES {states}
#define ABRACE_MEASURED {inputs}
#define ABRACE_COMMANDS {outputs}
#define ABRACE_SAMPLE_PERIOD {period} /* s, of the rig: abrace_controller_step is called so often */
#define ABRACE_HELD_SAMPLES {held} /* of these samples the first is answered, and the command held */
#define ABRACE_FADE_SAMPLES {fade} /* answered ones, of the force's fade-in */
#define ABRACE_STOP_SAMPLES {stop} /* of the force's ramp to zero */

/* Eq. (13): U = C q + D y; next q = A q + B y + G (U_acted - U), U_acted being what the limits left of U */
extern const double abrace_a[ABRACE_STATES][ABRACE_STATES];
extern const double abrace_b[ABRACE_STATES][ABRACE_MEASURED];
extern const double abrace_c[ABRACE_COMMANDS][ABRACE_STATES];
extern const double abrace_d[ABRACE_COMMANDS][ABRACE_MEASURED];
extern const double abrace_g[ABRACE_STATES][ABRACE_COMMANDS];
extern const double abrace_force_limit[ABRACE_COMMANDS]; /* in the unit of each command */
extern const double abrace_rate_limit[ABRACE_COMMANDS];  /* in this unit per second */

#endif
"""


def c_sources(controller: Controller, rate_limit: float, ramp_time: float) -> dict[str, str]:
    """The C99 sources of a controller, by file name.

    Parameters
    ----------
    rate_limit
        Greatest rate of the force of one brace [N/s], as the node's parameter.
    ramp_time
        Duration of the force's fade-in [s], as the node's parameter; the ramp to zero takes RAMP_TIME.

    Raises
    ------
    AbraceError
        If a limit cannot be used.
    """
    law, period = controller.law, controller.rig_period
    if not 0 <= ramp_time < float("inf"):
        raise AbraceError(f"ramp_time {ramp_time:g} s, expected 0 or more")
    rates = [rate_limit] * len(law.outputs)
    CommandGuard(controller.force_limit, rates, period, RAMP_TIME, "rate_limit")  # checks both limits
    texts = {key: _comment(getattr(controller, key)) for key in ("name", "model", "weights", "margins")}
    header = CONSTANTS.format(
        **texts,
        measured=_listed("measured", law, law.inputs),
        commands=_listed("force", law, law.outputs),
        states=law.order,
        inputs=len(law.inputs),
        outputs=len(law.outputs),
        period=repr(period),
        held=controller.of_rig(period),
        fade=round(ramp_time / law.sample_period),
        stop=int(RAMP_TIME / period * (1 + 1e-12)),
    )
    matrices = {"a": law.a, "b": law.b, "c": law.c, "d": law.d, "g": controller.correction}
    shapes = [line.split()[3].rstrip(";") for line in header.splitlines() if line.startswith("extern")]
    values = [*map(_matrix, matrices.values()), _row(controller.force_limit), _row(rates)]
    tables = [f"const double {shape} = {value};" for shape, value in zip(shapes, values, strict=True)]
    constants = "\n\n".join(['#include "constants.h"', *tables])
    return {**{name: source(name) for name in FIXED}, "constants.h": header, "constants.c": constants + "\n"}


def write_c(controller: Controller, folder: Path | str, rate_limit: float, ramp_time: float) -> None:
    """Write the sources of `c_sources` into a folder; it is made if it does not exist.

    Parameters
    ----------
    controller, rate_limit, ramp_time
        As for `c_sources`.
    folder
        Of the files.

    Raises
    ------
    AbraceError
        If a limit cannot be used, or the folder not written.
    """
    for name, text in c_sources(controller, rate_limit, ramp_time).items():
        write_text(Path(folder) / name, text)


def source(name: str) -> str:
    """The text of the installed source of this `name`."""
    return files("abrace_lqg.export").joinpath("c99", name).read_text(encoding="utf-8")


def _comment(text: str) -> str:
    """A text within a comment of C."""
    return " ".join(text.split()).replace("*/", "* /").replace("/*", "/ *") or "-"


def _listed(array: str, law: LinearModel, names: tuple[str, ...]) -> str:
    units = [_comment(law.unit(name)) for name in names]
    return "\n".join(f" *   {array}[{i}]  {_comment(name)} [{units[i]}]" for i, name in enumerate(names))


def _matrix(values: NDArray) -> str:
    return "{\n" + ",\n".join(f"    {_row(row)}" for row in values) + "}"


def _row(values: NDArray | list[float]) -> str:
    return "{" + ", ".join(repr(float(value)) for value in values) + "}"
