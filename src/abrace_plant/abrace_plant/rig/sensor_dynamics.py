# SPDX-License-Identifier: Apache-2.0
"""Sensor dynamics: transducers and anti-alias filters of finite bandwidth, cross-axis sensitivity.

Both are low-passes: a transducer with its conditioner one of second order with Butterworth's damping (close to the
phase of force-balance accelerometers and of LVDT demodulators), the anti-alias filter a Butterworth low-pass of
any order (Butterworth 1930), the same in every channel. The gain is 1 at rest and 3 dB less at the bandwidth. They are
solved in the substeps of the motion with signals that are linear in between (first-order hold).

The cross-axis sensitivity of an accelerometer is the share of an acceleration across its axis that it reads as one
along it (IEEE Std 1293; some per cent in data sheets). Across the axis of the floors only local modes move.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_plant.rig.model import Rig
    from abrace_plant.rig.sensors import AntiAlias, Sensor


def butterworth(cutoff: float, order: int) -> list[tuple[float, float]]:
    """Sections (omega [rad/s], damping ratio) of a Butterworth low-pass of `cutoff` [Hz]; damping nan: first order."""
    omega = 2 * np.pi * cutoff
    pairs = [(omega, float(np.cos((order - 1 - 2 * i) * np.pi / (2 * order)))) for i in range(order // 2)]
    return pairs + [(omega, np.nan)] * (order % 2)


def sections(sensor: Sensor, anti_alias: AntiAlias | None) -> list[tuple[float, float]]:
    """Those between a motion and the converter of a `sensor`; `anti_alias` None: no filter."""
    transducer = butterworth(sensor.bandwidth, 2) if np.isfinite(sensor.bandwidth) else []
    return transducer + (butterworth(anti_alias.cutoff, anti_alias.order) if anti_alias else [])


def low_pass(cascade: Sequence[tuple[float, float]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """State matrix (order, order) and input (order,) of a `cascade` of sections; the last state is the output."""
    order = sum(1 if np.isnan(damping) else 2 for _, damping in cascade)
    a, b = np.zeros((order, order)), np.zeros(order)
    at = 0
    for omega, damping in cascade:
        # a pair: q' = omega (u - p - 2 damping q), p' = omega q; p goes on
        first, a[at, at] = at, -omega
        if not np.isnan(damping):
            at += 1
            a[first, first], a[first, at], a[at, first] = -2 * damping * omega, -omega, omega
        if first:
            a[first, first - 1] = omega
        else:
            b[first] = omega
        at += 1
    return a, b


def filter_responses(rig: Rig, span: float) -> NDArray[np.float64]:
    """What a `span` [s] adds to the filters of [z, w] of a `rig`: (order + 1, order + 2, channels).

    Rows: the filter's states; its output. Columns: of the states (for the output, those at the end), of the signal at
    the begin, of the signal's change until the end (for the output, of the signal at the end). `order` is the greatest
    of all channels; where it is 0 there are no channels.
    """
    sensors = rig.sensors.channels(rig.floors, rig.groups, rig.groups)
    systems = [low_pass(sections(sensor, rig.sensors.anti_alias) if sensor else []) for sensor in sensors]
    most = max(len(b) for _, b in systems)
    responses = np.zeros((len(systems) if most else 0, most + 1, most + 2))
    for response, (a, b) in zip(responses, systems, strict=False):
        order = len(b)
        block = np.zeros((order + 2, order + 2))
        block[:order, :order], block[:order, order], block[order, order + 1] = a * span, b * span, 1.0
        solution = linalg.expm(block)[:order]
        response[:order, :order], response[:order, most:] = solution[:, :order], solution[:, order:]
        response[most, order - 1 if order else most + 1] = 1.0
    return np.ascontiguousarray(np.moveaxis(responses, 0, -1))


def with_cross_axis(rig: Rig) -> Rig:
    """The rig whose accelerometers see the local modes also across their axis."""
    share = rig.sensors.cross_axis
    if not share:
        return rig
    modes = tuple(
        replace(
            mode,
            accelerometer_share=tuple(
                along + share * across
                for along, across in zip(mode.accelerometer_share, mode.transverse_share, strict=True)
            ),
        )
        if mode.transverse_share
        else mode
        for mode in rig.local_modes
    )
    return replace(rig, local_modes=modes)
