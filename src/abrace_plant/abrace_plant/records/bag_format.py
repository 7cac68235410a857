# SPDX-License-Identifier: Apache-2.0
"""A bag, or its `.mcap` file, as a record: the table's acceleration in its test, or that of a floor (channel `a3`).

No sample may be missing. A clock that was set during the recording is a warning: samples have numbers.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from abrace_bags import Bag
from abrace_core import AbraceError
from abrace_core.model.signals import GROUND, meaning, unit, unit_of_field
from abrace_plant.records.reading import Reading, checked_reading, record_error

if TYPE_CHECKING:
    from pathlib import Path

    from abrace_plant.records.asked import Asked


def read_bag(name: str, path: Path, asked: Asked) -> Reading:
    """Read an acceleration of the test in a bag.

    Parameters
    ----------
    name
        Of the record, as the user gave it.
    path
        A bag directory or an MCAP file.
    asked
        Its channel is the name of an acceleration, in either form of `Run.channels`; None: w, the table's. Where the
        bag has several topics of responses, the topic and a colon stand before it.
    """
    topic, chosen = ((asked.channel or "").strip() or GROUND).rpartition(":")[::2]
    chosen = chosen.strip()
    try:
        bag = Bag(path)
        run = bag.run(topic or None)
    except AbraceError as error:
        raise AbraceError(f"ground motion {error}") from error
    known = [GROUND, *(each for each in run.names if unit(each) == "m/s^2")]
    places = {meaning(each): each for each in known}
    if meaning(chosen) not in places:
        other = unit_of_field(chosen)
        what = f"{chosen} is in {other}" if other not in ("m/s^2", "-") else f"no acceleration {chosen!r} in it"
        raise record_error(name, f"{what}, expected an acceleration: {asked.one_of(known)}")
    chosen = places[meaning(chosen)]
    if missing := [each for each in bag.damage if "have no checksum" not in each]:
        raise record_error(name, f"not whole: {missing[0]}")

    def error_at(message: str, _: int | None) -> AbraceError:
        return record_error(name, message, chosen)

    values = run.channels([chosen])[:, 0]
    reading = checked_reading(values, error_at, unit="m/s^2", sample_period=run.sample_period, chosen=chosen)
    return replace(reading, warnings=tuple(each for each in run.facts.get("warnings", ()) if each not in bag.damage))
