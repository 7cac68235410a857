# SPDX-License-Identifier: Apache-2.0
"""A bag, or its `.mcap` file, as a record: the table's acceleration in its test, or that of a floor (channel `a3`).

No sample may be missing. A clock that was set during the recording is a warning: samples have numbers.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from abrace_bags import Bag
from abrace_core import AbraceError
from abrace_core.model.signals import GROUND, unit
from abrace_plant.records.reading import Reading, checked_reading, record_error

if TYPE_CHECKING:
    from pathlib import Path


def read_bag(name: str, path: Path, channel: str | None) -> Reading:
    """Read an acceleration of the test in a bag.

    Parameters
    ----------
    name
        Of the record, as the user gave it.
    path
        A bag directory or an MCAP file.
    channel
        Name of an acceleration; None: w, the table's.
    """
    try:
        bag = Bag(path)
        run = bag.run()
    except AbraceError as error:
        raise AbraceError(f"ground motion {error}") from error
    known, chosen = (GROUND, *(each for each in run.names if unit(each) == "m/s^2")), (channel or GROUND).strip()
    if chosen not in known:
        raise record_error(name, f"no acceleration {chosen!r} in it, expected channel as one of {', '.join(known)}")
    if missing := [each for each in bag.damage if "have no checksum" not in each]:
        raise record_error(name, f"not whole: {missing[0]}")

    def error_at(message: str, _: int | None) -> AbraceError:
        return record_error(name, message, chosen)

    values = run.channels([chosen])[:, 0]
    reading = checked_reading(values, error_at, unit="m/s^2", sample_period=run.sample_period, chosen=chosen)
    return replace(reading, warnings=tuple(each for each in run.facts.get("warnings", ()) if each not in bag.damage))
