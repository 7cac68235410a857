# SPDX-License-Identifier: Apache-2.0
"""Identification from measured data of any structure, without knowledge of what the channels mean.

transfer functions  from all inputs at once, by default by the local rational method
modes               searched in all lines (`mode_search`), refined by maximum likelihood
delays              of single channels, estimated with these modes (`output_delays`), and taken off before the last fit
model               one state-space model for all inputs: these modes, and residual terms for modes above the band if
                    they pay
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from pydantic import BeforeValidator, Field, model_validator
from scipy import fft

from abrace_core import AbraceError
from abrace_core.files.options import NOT_GIVEN, Band, Names
from abrace_core.model import signals
from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import takes_models
from abrace_core.model.simulation import simulate
from abrace_sysid.examination import prepared
from abrace_sysid.fitting.clocks import clock_of
from abrace_sysid.fitting.mode_search import find_modes
from abrace_sysid.fitting.observation import Observation, Record, names_of
from abrace_sysid.fitting.output_delays import SETTLED, Delay, input_delays, output_delays
from abrace_sysid.fitting.residual_terms import fit_with_residual_terms, residual_poles
from abrace_sysid.fitting.vector_fitting import HEAVY_DAMPING
from abrace_sysid.models.modal import modal_model
from abrace_sysid.recorded.test import DataHold, TableOptions, Test, given_tests, of_one_rig
from abrace_sysid.spectra.bands import steady_band
from abrace_sysid.spectra.estimation import TransferFunctionOptions, frequency_responses

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_core.model.linear_model import LinearModel
    from abrace_sysid.fitting.clocks import Clock
    from abrace_sysid.fitting.mode_search import FoundModes
    from abrace_sysid.fitting.pole_estimate import PoleEstimate, PoleInterval
    from abrace_sysid.spectra.frequency_response import FrequencyResponse


LEAST_LINES = 10
"""The default band begins at this multiple of the record's frequency resolution (1 / duration).

A slower mode completes fewer than ten periods within the record.
"""

BEYOND = 1.5
"""By default lines are fitted up to this multiple of what the inputs excite."""

HIGHEST = 0.48
"""Highest frequency that is fitted by default, times the sample period: beyond it no filter is steep enough."""

NEAR_TOP = 0.95
"""A pair that is not sure beyond this share of the highest frequency fitted stands for what lies above."""

MOST_POLES = 60
"""Most pole pairs that are searched, and of a model."""

SAME_PERIOD = 0.2
"""Greatest change of an input from period to period, as a share of its rms, with which it is periodic."""

LEAST_SAMPLES = 400
"""Samples that a record must have at least: half of a shorter one has too few lines for more than one or two modes."""


def _units_of(given: Any) -> Any:
    """The units by name, from texts `given` as NAME=UNIT; anything else as it is given.

    >>> _units_of(["a1=m/s^2", "force=N"])
    {'a1': 'm/s^2', 'force': 'N'}
    """
    if not isinstance(given, (list, tuple)):
        return given
    found = {}
    for text in given:
        name, _, unit = str(text).partition("=")
        if not (name and unit):
            raise ValueError("NAME=UNIT")
        found[name] = unit
    return found


Units = Annotated[dict[str, str], BeforeValidator(_units_of)]
"""Units by name: a mapping, or texts NAME=UNIT."""


class DataOptions(TableOptions, TransferFunctionOptions):
    """Options of an identification from measured data: of its columns, and of the fit."""

    who: ClassVar[str] = "identification"

    inputs: Names = Field(min_length=1, description="names of the input columns")
    outputs: Names = Field(default=(), description="names of the output columns; none: all others")
    units: Units = Field(default={}, description="NAME=UNIT of columns that do not state it, kept with the model")
    hold: DataHold = Field(
        default="band", description="inputs sampled as the outputs, band-limited, or held between samples (zero)"
    )
    band: Band = Field(default=NOT_GIVEN, description="Hz; 0, 0: what all inputs excite, from 10 / duration on")
    modes: Annotated[int, Field(ge=0, le=MOST_POLES)] = Field(
        default=0, description="pole pairs of the model, the best ones; 0: as many as pay"
    )
    order: Annotated[int, Field(ge=0, le=2 * MOST_POLES)] = Field(
        default=0,
        description="states of the model, two for each pole pair, with none for modes above the band; 0: by modes, and "
        "two for each input for the modes above if they pay",
    )
    held_out: Annotated[float, Field(ge=0, le=0.8)] = Field(
        default=0.0, description="share at the end of each record that is held out and predicted"
    )

    @model_validator(mode="after")
    def _of_pairs(self) -> DataOptions:
        if self.order % 2:
            raise ValueError(f"order {self.order}: an even number, two states for each pole pair")
        if self.order and self.modes and self.order != 2 * self.modes:
            raise ValueError(f"order {self.order} and modes {self.modes}: order {2 * self.modes}, or one of the two")
        return self

    @property
    def pairs(self) -> int:
        """Number of pole pairs that is given; 0: none is."""
        return self.modes or self.order // 2

    def read(self, data: Any) -> tuple[Test, ...]:
        """The records `data`, one or several: tests, or the columns of files, DataFrames and arrays by name."""
        return given_tests(data, self.model_dump(include={"inputs", "outputs", "sample_rate", "time", "units", "hold"}))


@dataclass(frozen=True)
class DataIdentification:
    """The identified model of a structure, and the estimates from which it was computed.

    Parameters
    ----------
    tests
        The records as measured, examined.
    records
        The records used, each without its channels that do not respond to the inputs, the others moved in time.
    band
        [Hz] of the transfer functions: what the inputs excite, or as given.
    fitted
        [Hz] of the lines to which the modes were fitted.
    responses
        Transfer functions from each input.
    estimate
        Poles and mode shapes fitted by maximum likelihood.
    is_mode
        (pairs,) which of its first pairs are modes; the others only serve to predict.
    not_driven
        [rad/s] poles of motion that the inputs do not cause (hum, drift, free decay); not in the model.
    model
        The same fit as a continuous state-space model; its input delay is that which all outputs have.
    delays
        By output, against the inputs, and by input, how late it acts against the first; those that are certain.
    clocks
        Of outputs whose clock is certain to differ from that of the inputs; they are warned of, and stay in the model.
    """

    tests: tuple[Test, ...]
    records: tuple[Test, ...]
    band: tuple[float, float]
    fitted: tuple[float, float]
    responses: tuple[FrequencyResponse, ...]
    estimate: PoleEstimate
    is_mode: NDArray[np.bool_]
    not_driven: NDArray[np.complex128]
    model: LinearModel
    delays: Mapping[str, Delay]
    clocks: Mapping[str, Clock]

    @property
    def source(self) -> str:
        """The records' names."""
        return _sources(self.tests)

    @property
    def warnings(self) -> tuple[str, ...]:
        """About the data, one sentence each."""
        texts, period = [text for test in self.tests for text in test.warnings], self.tests[0].sample_period
        by_words: dict[str, list[str]] = {}
        for name, delay in self.delays.items():
            by_words.setdefault(delay.words(period), []).append(name)
        inputs = self.model.inputs
        for words, names in by_words.items():
            against = f"in its action against {inputs[0]}" if names[0] in inputs else "against the inputs"
            texts.append(f"{self.source}: {', '.join(names)} {words} {against}: taken into account")
        for name, clock in self.clocks.items():
            texts.append(
                f"{self.source}: the clock of {name} is {clock.words()} against that of the inputs: use one clock for "
                "all channels, or resample this one"
            )
        sizes = np.sort(np.abs(self.estimate.poles[: len(self.is_mode)][~self._listed])) / (2 * np.pi)
        above = sizes > NEAR_TOP * self.fitted[1]
        for size in sizes[~above]:
            texts.append(
                f"{self.source}: a pair at {size:.4g} Hz predicts, but is too uncertain to be listed as a mode"
            )
        if above.any():
            who = "a pair stands" if above.sum() == 1 else f"{above.sum()} pairs stand"
            texts.append(f"{self.source}: {who} for what lies above the lines that were fitted, not for a mode")
        for pole in self.not_driven:
            size = abs(pole) / (2 * np.pi)
            texts.append(
                f"{self.source}: motion at {size:.4g} Hz that the inputs do not cause is left out of the model"
            )
        return tuple(texts)

    @property
    def _listed(self) -> NDArray[np.bool_]:
        """(pairs,) which pairs are listed as modes."""
        places = range(len(self.is_mode))
        sure = [self.estimate.pairs([place])[0].is_sure for place in places]
        return self.is_mode & np.array(sure, dtype=np.bool_)

    @property
    def pairs(self) -> tuple[PoleInterval, ...]:
        """Modes with their intervals, lowest frequency first.

        Pairs that are not sure (`PoleInterval.is_sure`), or not told from others, stay in the model and are warned of.
        """
        return tuple(self.estimate.pairs(np.flatnonzero(self._listed)))

    def in_time(self, test: Test) -> Test:
        """Another `test` of these channels, its outputs moved in time as those of the records used.

        The delays that all outputs have, and those of inputs, are in the model.
        """
        model = self.model
        return test.in_time(_moves(self.delays, model.inputs[0], model.outputs, model.input_delay))


def identify_data(
    data: Test | Sequence[Test],
    options: DataOptions | None = None,
    progress: Callable[[str, float], None] = lambda _step, _fraction: None,
) -> DataIdentification:
    """Identify a structure from measured inputs and outputs.

    Parameters
    ----------
    data
        One or several records with the same inputs, each with its own outputs where sensors were moved between them;
        all inputs may be excited at once, by signals that are not proportional.
    options
        By default those of `DataOptions`.
    progress
        Called at the beginning of each step, with the step's name and the fraction of the work done.

    Raises
    ------
    AbraceError
        If the data or an option cannot be used, or no stable model is found.
    """
    tests = of_one_rig(data, alike=["inputs"])
    inputs = tests[0].inputs
    options = options or DataOptions(inputs=inputs)
    for test in tests:
        if len(test.outputs) < LEAST_SAMPLES:
            raise AbraceError(f"{test.source}: {len(test.outputs)} samples, expected at least {LEAST_SAMPLES}")
    band = options.band
    if band == NOT_GIVEN:
        bands = [steady_band(test, inputs, LEAST_LINES / test.seconds) for test in tests]
        band = max(low for low, _ in bands), min(high for _, high in bands)
    progress("checking the data", 0.0)
    tests = tuple(prepared(test, dict.fromkeys(inputs, band)) for test in tests)
    alive = [test.select([name for name in test.names if name not in test.faults]) for test in tests]
    # lines with little input hold free decays and noise, and tell about these; far above the input they say nothing
    fitted = band
    if options.band == NOT_GIVEN:
        fitted = 0.0, min(BEYOND * band[1], HIGHEST / tests[0].sample_period)

    progress("transfer functions", 0.05)
    responses = frequency_responses(alive, inputs, band, options)

    def search(records: Sequence[Test]) -> FoundModes:
        whole = observed(records, fitted)
        return find_modes(
            whole,
            residual_poles(whole[0])[:1],
            MOST_POLES,
            lambda modes: progress(f"modes: {modes}", 0.1 + 0.6 * modes / (modes + 10)),
            options.pairs,
        )

    found = search(alive)
    if found.passes_through:
        # distortion repeats with the periods, on some lines only: one mean period has one kind of lines
        periods = [_mean_period(one) for one in alive]
        repeating = [one for one in periods if one is not None]
        if len(repeating) == len(alive):
            alive = repeating
            found = search(alive)
    progress("delays of outputs", 0.8)
    delays, records = _delays(alive, band, found.poles), alive
    if delays:
        records = [_all_in_time(one, delays) for one in alive]
        in_time = search(records)
        # the lag of a servo looks like a delay, and is a heavily damped pole if that costs less
        if in_time.cost < found.cost:
            found = in_time
        else:
            delays, records = {}, alive
    if not len(found.poles):
        raise AbraceError(
            f"{_sources(tests)}: no mode from {fitted[0]:.4g} to {fitted[1]:.4g} Hz: nothing that the inputs cause "
            "there stands out of the noise"
        )
    outputs = names_of(observed(alive, band))[1]
    late = _input_delay(delays, inputs, outputs)
    moves = _moves(delays, inputs[0], outputs, late)
    used = tuple(one.in_time(moves) for one in alive)
    if delays:
        responses = frequency_responses(used, inputs, band, options)
    progress("maximum likelihood", 0.9)
    estimate = _fitted(observed(records, fitted), found, bool(options.order))
    more = len(estimate.poles) > len(found.poles)
    provenance = {
        "data": _sources(tests),
        "sample_period": tests[0].sample_period,
        "seconds": sum(test.seconds for test in tests),
        "band": list(band),
        "method": responses[0].method,
        "options": options.model_dump(),
        "hold": tests[0].hold,
        "output_delays": moves,
        "states": f"{len(found.poles)} pairs by maximum likelihood, {np.count_nonzero(found.is_mode)} of them modes"
        + (", and one pair for each input that represents modes above" if more else ""),
    }
    model = replace(modal_model(estimate, provenance), input_delay=late)
    units = {name: unit for test in tests for name, unit in test.units.items()}
    model = replace(model, units={name: units[name] for name in (*model.inputs, *model.outputs) if name in units})
    clocks = _clocks(model, used)
    progress("identified", 1.0)
    return DataIdentification(
        tests, used, band, fitted, responses, estimate, found.is_mode, found.not_driven, model, delays, clocks
    )


def _mean_period(record: Test) -> Test | None:
    """The mean of the periods after the first; None: there are not two, or too few samples in one."""
    period, samples = record.period or 0, len(record.outputs)
    if period < LEAST_SAMPLES or samples < 2 * period:
        return None
    excitation, later = record.excitation[:-period], record.excitation[period:]
    if np.any(np.std(later - excitation, axis=0) > SAME_PERIOD * np.std(later, axis=0)):
        return None
    kept = (samples // period - 1) * period

    def mean(series: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(series[len(series) - kept :].reshape(-1, period, series.shape[1]).mean(axis=0))

    return replace(record, excitation=mean(record.excitation), outputs=mean(record.outputs))


def observed(records: Sequence[Test], band: tuple[float, float]) -> list[Observation]:
    """The lines of each of the `records` in a `band` [Hz], of all their inputs; ends are free if these are not held."""
    return [
        replace(
            Observation.of_test(one, one.inputs, band),
            free_ends=one.hold == "band",
            record=Record.of(one.channels(one.inputs)),
        )
        for one in records
    ]


def _fitted(whole: Sequence[Observation], found: FoundModes, order_is_given: bool) -> PoleEstimate:
    """Shapes, drives and intervals for the poles that were found, all refined together; the poles as found if not.

    With residual terms of modes above the band if they pay, and the order is not given.
    """
    weighted = [
        replace(one.with_noise(level), transient=not found.at_rest, from_rest=found.at_rest)
        for one, level in zip(whole, found.noise, strict=True)
    ]
    fits = []
    for with_above in (False,) if order_is_given else (False, True):
        with contextlib.suppress(AbraceError):
            fits.append(fit_with_residual_terms(weighted, found.poles, with_above=with_above))
    if fits:
        return min(fits, key=attrgetter("mdl"))
    alone = [replace(one, free_ends=False) for one in weighted]
    return fit_with_residual_terms(alone, found.poles, 0, with_above=not order_is_given)


ROUNDS = 6
"""Most rounds of delays for these modes and modes for these delays."""


def _all_in_time(record: Test, delays: Mapping[str, Delay]) -> Test:
    """A record with all these delays taken off."""
    return record.in_time({name: delay.seconds for name, delay in delays.items()})


def _delays(records: Sequence[Test], band: tuple[float, float], poles: NDArray[np.complex128]) -> dict[str, Delay]:
    """The certain delays, by channel. The modes fitted without them are refined with them in turn."""
    poles, period = _modes_alone(poles, band), records[0].sample_period
    inputs, outputs = names_of(observed(records, band))
    found: dict[str, Delay] = {}
    for turn in range(ROUNDS if len(poles) else 0):
        change = 0.0
        for names, delays_of in ((inputs[1:], input_delays), (outputs, output_delays)):
            if not names or (turn and found.keys().isdisjoint(names)):
                continue
            whole = observed([_all_in_time(one, found) for one in records], band)
            steps = delays_of(whole, np.concatenate([poles, residual_poles(whole[0])[:1]]))
            for name, step in zip(names, steps, strict=True):
                if name in found:
                    seconds = found[name].seconds + step.seconds
                    found[name] = step._replace(seconds=seconds, left=found[name].left)
                    change = max(change, abs(step.seconds))
                elif not turn and step.is_certain:
                    found[name] = step
                    change = np.inf
        if change < SETTLED * period:
            break
        whole = observed([_all_in_time(one, found) for one in records], band)
        try:
            poles = _modes_alone(fit_with_residual_terms(whole, poles, spread="none").poles[: len(poles)], band)
        except AbraceError:
            break
    return {name: delay for name, delay in found.items() if delay.is_certain}


def _clocks(model: LinearModel, records: Sequence[Test]) -> dict[str, Clock]:
    """The clocks that certainly differ from the inputs', by output, from the record that tells most about each."""
    found: dict[str, Clock] = {}
    for one in records:
        foreseen, measured = predicted(model.select(one.names), one), one.channels(one.names)
        for name, *both in zip(one.names, measured.T, foreseen.T, strict=True):
            clock = clock_of(*both)
            if name not in found or clock.deviation < found[name].deviation:
                found[name] = clock
    return {name: clock for name, clock in found.items() if clock.is_certain}


def _modes_alone(poles: NDArray[np.complex128], band: tuple[float, float]) -> NDArray[np.complex128]:
    """The light pairs in the band; a heavy one may represent a delay."""
    size = np.abs(poles)
    return poles[(-poles.real < HEAVY_DAMPING * size) & (size < 2 * np.pi * band[1]) & (poles.imag > 0)]


def _input_delay(delays: Mapping[str, Delay], inputs: Sequence[str], outputs: Sequence[str]) -> tuple[float, ...]:
    """The delays [s] of the inputs, none before 0: what all outputs have, and what each input has."""
    common = max(0.0, min(delays[name].seconds if name in delays else 0.0 for name in outputs))
    own = [delays[name].seconds if name in delays else 0.0 for name in inputs]
    return tuple(common + each - min(own) for each in own)


def _moves(
    delays: Mapping[str, Delay], first_input: str, outputs: Sequence[str], late: Sequence[float]
) -> dict[str, float]:
    """How late [s] the outputs are beside the delays of the inputs."""
    first = late[0] - (delays[first_input].seconds if first_input in delays else 0.0)
    moves = {name: (delays[name].seconds if name in delays else 0.0) - first for name in outputs}
    return {name: by for name, by in moves.items() if by}


def _sources(tests: Sequence[Test]) -> str:
    return ", ".join(dict.fromkeys(test.source for test in tests))


@takes_models
def variance_accounted_for(
    model: LinearModel, data: Test | Sequence[Test], band: tuple[float, float] | None = None
) -> NDArray[np.float64]:
    """(outputs,) 1 minus the ratio of the variances of prediction error and measured output, of what is in a band.

    NaN: the output does not move, or has a value that is not finite, in one of the records that have it; or all outputs
    of a record together have no more samples than the model has states, with which any initial state fits.

    Parameters
    ----------
    model, band
        As for `predicted`.
    data
        One or several records, each with its own initial state; together they have all outputs of the model.

    Raises
    ------
    AbraceError
        If an output of the model is in no record.
    """
    records = (data,) if isinstance(data, Test) else tuple(data)
    signals.positions(
        model.outputs, [name for one in records for name in one.names], f"{_sources(records)}: no channel"
    )
    missed, whole = np.zeros(len(model.outputs)), np.zeros(len(model.outputs))
    for one in records:
        known = _measured_of(model.outputs, one)
        measured = one.channels([model.outputs[i] for i in known])
        usable = np.isfinite(measured).all(axis=0) & (np.ptp(measured, axis=0) > 0)
        if measured.size <= model.order or not np.isfinite(one.excitation).all():
            usable[:] = False
        missed[known[~usable]] = np.nan
        if usable.any():
            own = known[usable]
            kept = _within(band, one, measured[:, usable])
            left = kept - predicted(model.select([model.outputs[i] for i in own]), one, band)
            missed[own] += len(kept) * np.var(left, axis=0)
            whole[own] += len(kept) * np.var(kept, axis=0)
    with np.errstate(invalid="ignore"):
        return np.asarray(1 - missed / whole)


def _measured_of(outputs: Sequence[str], record: Test) -> NDArray[np.int64]:
    """The indices of those of the outputs that a record has."""
    there = set(map(signals.meaning, record.names))
    return np.array([i for i, name in enumerate(outputs) if signals.meaning(name) in there], dtype=np.int64)


@takes_models
def predicted(model: LinearModel, data: Test, band: tuple[float, float] | None = None) -> NDArray[np.float64]:
    """(samples, outputs) the model's response to the inputs, with the initial state that fits the outputs best.

    Parameters
    ----------
    model
        Stable, with inputs and outputs that the data contain; the outputs move. A continuous model is used with the
        data's hold; a discrete one is simulated sample by sample.
    data
        The test. The inputs' means are subtracted; the outputs' means are kept.
    band
        Only what lies in this band [Hz] is fitted and returned, with the means; None: everything.
    """
    inputs = data.channels(model.inputs)
    measured = data.channels(model.outputs)
    inputs, offset = inputs - inputs.mean(axis=0), measured.mean(axis=0)
    samples = len(inputs)
    if not model.sample_period and data.hold != "band":
        model = discretize(model, data.sample_period, data.holds)
    if model.sample_period:
        forced = simulate(model, inputs)
    else:
        omega = 2 * np.pi * fft.rfftfreq(samples, data.sample_period)
        response = model.frequency_response(omega)
        forced = fft.irfft(np.einsum("fpm,fm->fp", response, fft.rfft(inputs, axis=0)), samples, axis=0)
    values, vectors = np.linalg.eig(model.a)
    step = values if model.sample_period else np.exp(values * data.sample_period)
    upper = np.flatnonzero(values.imag >= 0)
    size = measured.std(axis=0)
    columns = []
    for i in upper:
        free = np.outer(step[i] ** np.arange(samples), (model.c @ vectors[:, i]) / size)
        parts = (free.real, free.imag) if values[i].imag > 0 else (free.real,)
        columns += [_within(band, data, part).ravel() for part in parts]
    basis = np.column_stack(columns)
    length = np.linalg.norm(basis, axis=0)
    basis /= np.where(length > 0, length, 1.0)
    forced, measured = _within(band, data, forced), _within(band, data, measured - offset)
    left_over = ((measured - forced) / size).ravel()
    fitted = basis @ np.linalg.lstsq(basis, left_over, rcond=1e-12)[0]
    return np.asarray(offset + forced + fitted.reshape(forced.shape) * size)


def _within(band: tuple[float, float] | None, data: Test, series: NDArray[np.float64]) -> NDArray[np.float64]:
    """The part of a `series` (samples, columns) of the data that lies in a band [Hz]; None: all of it."""
    if band is None:
        return series
    frequency = fft.rfftfreq(len(series), data.sample_period)[:, None]
    lines = fft.rfft(series, axis=0) * ((frequency >= band[0]) & (frequency <= band[1]))
    return np.asarray(fft.irfft(lines, len(series), axis=0))
