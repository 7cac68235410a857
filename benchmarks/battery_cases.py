# SPDX-License-Identifier: Apache-2.0
"""Random structures with known modes and their simulated tests: the cases of `battery`.

A case is drawn by its kind and number alone. The inputs pass an anti-aliasing filter before they act, are linear
between OVER steps a sample, and are sampled with the outputs; held inputs keep their value from sample to sample.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from battery_structure import Structure
from scipy import signal

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

EASY = ("noise", "coloured", "sweep", "multisine", "hit", "hits", "quake")
HARD = (
    "two_inputs",
    "closed_loop",
    "rests",
    "late",
    "input_noise",
    "drift",
    "hum",
    "held",
    "unmeasured_force",
    "close_modes",
    "many_outputs",
)
NUMBERS = dict.fromkeys(EASY, 30) | dict.fromkeys(HARD, 10)
"""How many cases of each kind."""

SEED = 48
OVER = 16
"""Simulation steps a sample."""

PASSED = 0.36
"""Highest frequency that the anti-aliasing filter passes, times the sample period; from 0.43 on it takes 80 dB."""


@dataclass(frozen=True)
class Case:
    """A simulated test of a known structure.

    Parameters
    ----------
    kind, number
        Which case.
    structure
        The truth, from the measured inputs.
    sample_rate
        Hz.
    driving
        (steps, inputs) inputs as they act, at `over` steps a sample.
    hold
        Between these steps: "first" or "zero".
    inputs, outputs
        (samples, inputs) and (samples, outputs) as measured.
    foreseen
        (samples, outputs) what the truth makes of the measured inputs.
    white
        (outputs,) variance of the white noise of each output.
    of_input
        (inputs,) variance of the white noise of the measured inputs.
    walk
        (outputs,) variance of the steps of each output's drift.
    other_force
        (outputs, modes) residues of a force that is not measured, white up to PASSED with variance 1 a sample.
    late
        (outputs,) by how many simulation steps each output is late.
    """

    kind: str
    number: int
    structure: Structure
    sample_rate: float
    driving: Array
    hold: str
    inputs: Array
    outputs: Array
    foreseen: Array
    white: Array
    of_input: Array
    walk: Array
    other_force: Array
    late: NDArray[np.int64]

    @property
    def over(self) -> int:
        """Simulation steps a sample."""
        return len(self.driving) // len(self.outputs)

    @property
    def cut(self) -> int:
        """Samples of the first two thirds, to which a model is fitted."""
        return 2 * len(self.outputs) // 3

    @property
    def delays(self) -> dict[str, float]:
        """By how many seconds each late output is late."""
        step = 1 / (self.sample_rate * self.over)
        return {f"y{i + 1}": float(late * step) for i, late in enumerate(self.late) if late}

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return ("u",) if self.inputs.shape[1] == 1 else tuple(f"u{j + 1}" for j in range(self.inputs.shape[1]))

    @property
    def columns(self) -> dict[str, Array]:
        """The measured samples by name, inputs first."""
        outputs = {f"y{i + 1}": column for i, column in enumerate(self.outputs.T)}
        return dict(zip(self.input_names, self.inputs.T, strict=True)) | outputs

    def sampled(self, modal: Array, residues: Array) -> Array:
        """(samples, outputs) of modal responses, each output as late as it is.

        Parameters
        ----------
        modal
            (steps, inputs, modes).
        residues
            (outputs, inputs, modes).
        """
        whole = np.einsum("tmn,pmn->tp", modal, residues)
        columns = [
            np.concatenate([np.zeros(late), column])[: len(whole)]
            for late, column in zip(self.late, whole.T, strict=True)
        ]
        return np.column_stack(columns)[:: self.over]

    def noise_spectrum(self, frequency: NDArray[Any]) -> NDArray[np.complex128]:
        """(lines, outputs, outputs) spectrum, variance a sample, of all that the truth does not foresee but hum.

        Parameters
        ----------
        frequency
            (lines,) Hz, above 0.
        """
        wave = np.abs(2 * np.sin(np.pi * frequency / self.sample_rate)) ** 2
        found = np.asarray(
            (self.white + self.walk / wave[:, None])[:, :, None] * np.eye(len(self.white)), dtype=complex
        )
        if self.of_input.any():
            h = self.structure.transfer(frequency)
            found += np.einsum("fpm,m,fqm->fpq", h, self.of_input, h.conj())
        if self.other_force.any():
            h = replace(self.structure, residues=self.other_force[:, None]).transfer(frequency)
            passed = (frequency < PASSED * self.sample_rate) / (2 * PASSED)
            found += np.einsum("f,fpm,fqm->fpq", passed, h, h.conj())
        return found


def case(kind: str, number: int) -> Case:
    """The case of a kind and a number, always the same.

    Parameters
    ----------
    kind
        One of `EASY` or `HARD`.
    number
        From 0 on.
    """
    random = np.random.default_rng((SEED, (*EASY, *HARD).index(kind), number))
    structure = _structure(kind, random)
    tops = structure.frequencies / (2 * np.pi)
    rate = float(tops[-1] * random.uniform(3, 8))
    samples = int(np.clip(random.uniform(40, 250) / tops[0] * rate, 1200, 20000))
    outputs, inputs, _ = structure.residues.shape
    over = 1 if kind == "held" else OVER
    driving = np.column_stack([_excitation(kind, random, samples, rate, tops, over) for _ in range(inputs)])
    level = 10 ** random.uniform(-3, -1)
    felt = None
    if kind == "closed_loop":
        driving, felt = _fed_back(structure, driving, level, rate * over, random)
    hold = "zero" if kind == "held" else "first"
    late = np.zeros(outputs, dtype=np.int64)
    if kind == "late":
        late = np.where(random.random(outputs) < 0.5, random.integers(OVER // 4, 3 * OVER, outputs), 0)
        late[int(random.integers(outputs))] = int(random.integers(OVER // 4, 3 * OVER))
    nothing = np.zeros(outputs)
    empty = np.zeros((samples, outputs))
    made = Case(
        kind, number, structure, rate, driving, hold, driving[::over], empty, empty, nothing, np.zeros(inputs),
        nothing, np.zeros((outputs, len(tops))), late,
    )  # fmt: skip
    clean = made.sampled(structure.modal_responses(driving, 1 / (rate * over), hold), structure.residues)
    size = clean.std(axis=0)
    noise, white = level * size * random.normal(size=clean.shape), (level * size) ** 2
    if felt is not None:
        noise[:, 0], white[0] = felt[::over], felt[::over].var()
    made = replace(made, outputs=clean + noise, foreseen=clean, white=white)
    return _disturbed(made, random)


def _structure(kind: str, random: np.random.Generator) -> Structure:
    least = {"close_modes": 2, "many_outputs": 2}.get(kind, 1)
    modes = int(random.integers(least, 7))
    first = np.exp(random.uniform(np.log(0.4), np.log(5.0)))
    tops = first * np.cumsum(np.append(1.0, random.uniform(0.4, 2.2, modes - 1)))
    if kind == "close_modes":
        place = int(random.integers(1, modes))
        tops[place:] *= tops[place - 1] * random.uniform(1.01, 1.03) / tops[place]
    dampings = np.exp(random.uniform(np.log(0.001), np.log(0.04), modes))
    outputs = modes if kind == "many_outputs" else int(random.integers(1, 4))
    inputs = 2 if kind == "two_inputs" else 1
    shapes, drives = random.normal(size=(outputs, modes)), random.normal(size=(inputs, modes))
    measured = ("displacement", "acceleration", "absolute acceleration")[random.choice(3, p=(0.5, 0.25, 0.25))]
    return Structure(2 * np.pi * tops, dampings, shapes[:, None] * drives, measured)


def _excitation(kind: str, random: np.random.Generator, samples: int, rate: float, tops: Array, over: int) -> Array:
    """(samples * over,) an input, filtered."""
    steps, fast = samples * over, rate * over
    time = np.arange(steps) / fast
    share = time / time[-1]
    if kind == "held":  # a computer's command, as it leaves the converter
        low = signal.butter(2, min(1.3 * tops[-1], 0.45 * rate), fs=rate, output="sos")
        return np.asarray(signal.sosfilt(low, random.normal(size=steps)))
    if kind == "sweep":
        force = signal.chirp(time, 0.13 * tops[0], time[-1], 1.25 * tops[-1])
    elif kind == "multisine":
        period = int(samples / random.uniform(2.2, 5))
        lines = np.zeros(period * over // 2 + 1, dtype=np.complex128)
        used = np.arange(1, int(0.4 * period))
        lines[used] = np.exp(2j * np.pi * random.random(len(used)))
        force = np.resize(np.fft.irfft(lines, period * over), steps)
    elif kind in ("hit", "hits"):
        force, width = np.zeros(steps), random.uniform(0.15, 0.4) / tops[-1]
        for begin in [0.02 * time[-1]] if kind == "hit" else np.sort(random.uniform(0.02, 0.9, 5)) * time[-1]:
            inside = (time > begin) & (time < begin + width)
            force += random.uniform(0.6, 1.4) * inside * np.sin(np.pi * (time - begin) / width)
    else:
        force = random.normal(size=steps)
        if kind == "coloured":
            force = signal.sosfilt(signal.butter(1, tops[0], fs=fast, output="sos"), force)
        elif kind == "quake":
            ends = [0.3 * tops[0], min(3 * tops[-1], 0.45 * fast)]
            force = signal.sosfilt(signal.butter(2, ends, "band", fs=fast, output="sos"), force)
            force *= 8 * share * np.exp(1 - 8 * share) + 0.02
        elif kind == "rests":
            first, second, third = random.uniform([0.05, 0.35, 0.75], [0.15, 0.45, 0.85])
            force *= ((share > first) & (share < second)) | ((share > second + 0.1) & (share < third)) | (share > 0.9)
    return np.asarray(signal.sosfilt(signal.ellip(10, 0.1, 80, PASSED * rate, fs=fast, output="sos"), force))


def _fed_back(
    structure: Structure, reference: Array, level: float, fast: float, random: np.random.Generator
) -> tuple[Array, Array]:
    """(steps, 1) the input by which a controller adds damping, and (steps,) noise of the first output, its sensor."""
    a, b, c, d = structure.state_space()
    c, d = c[:1], d[:1]
    w = structure.frequencies
    corner = 2 * w[-1] if structure.measured == "displacement" else 0.5 * w[0]
    # about the velocity: its zero at 0, and the corner above or below the modes
    af, bf, cf, _ = signal.tf2ss([1.0, 0.0], [1.0, 1.4 * corner, corner**2])
    output = structure.modal_responses(reference, 1 / fast)[:, 0] @ structure.residues[0, 0]
    felt = _response(af, bf, cf, output[:, None], 1 / fast)
    strongest = int(np.argmax(np.abs(structure.residues[0, 0]) / structure.dampings))
    pole = structure.poles[strongest]
    through = structure.residues[0, 0, strongest] * structure.numerators(pole[None])[strongest] / (2j * pole.imag)
    turn = through * pole / (pole**2 + 1.4 * corner * pole + corner**2)
    gain = float(np.sign(turn.real) * reference.std() / felt.std())
    least = -0.5 * float(np.min(structure.dampings * w))
    while True:
        loop = np.block([[a, -gain * b @ cf], [bf @ c, af - gain * bf @ d @ cf]])
        if np.linalg.eigvals(loop).real.max() < least:
            break
        gain /= 1.5
    drive = np.hstack([np.vstack([b, bf @ d]), np.vstack([0 * b, bf])])
    taken = np.hstack([np.zeros((1, len(a))), -gain * cf])
    quiet = reference + _response(loop, drive[:, :1], taken, reference, 1 / fast)
    size = (structure.modal_responses(quiet, 1 / fast)[:, 0] @ structure.residues[0, 0]).std()
    # white at the samples, and nothing above half the sample rate, which would be folded into the sampled input
    white = random.normal(size=len(reference) // OVER)
    noise = level * size * np.asarray(signal.resample(white, len(reference)))
    return quiet + _response(loop, drive[:, 1:], taken, noise[:, None], 1 / fast), noise


def _response(a: Array, b: Array, c: Array, inputs: Array, step: float) -> Array:
    """(steps, outputs) from rest, of inputs that are linear between steps."""
    poles, vectors = np.linalg.eig(a)
    drive, seen = np.linalg.solve(vectors, b.astype(np.complex128)), c @ vectors
    found = np.zeros((len(inputs), len(c)))
    for k, pole in enumerate(poles):
        whole = np.expm1(pole * step)
        held, ramp = whole / pole, (whole - pole * step) / (pole**2 * step)
        state = signal.lfilter([ramp, held - ramp], [1, -1 - whole], inputs @ drive[k])
        found += np.real(np.outer(state, seen[:, k]))
    return found


def _disturbed(made: Case, random: np.random.Generator) -> Case:
    """The case with what its kind adds to the measured samples."""
    size, shape = made.foreseen.std(axis=0), made.outputs.shape
    if made.kind == "input_noise":
        spread = random.uniform(0.005, 0.03) * made.inputs.std(axis=0)
        wrong = spread * random.normal(size=made.inputs.shape)
        lines = np.fft.rfft(wrong, 4 * len(wrong), axis=0)
        transfer = made.structure.transfer(np.fft.rfftfreq(4 * len(wrong), 1 / made.sample_rate))
        caused = np.fft.irfft(np.einsum("fpm,fm->fp", transfer, lines), 4 * len(wrong), axis=0)[: len(wrong)]
        return replace(made, inputs=made.inputs + wrong, foreseen=made.foreseen + caused, of_input=spread**2)
    if made.kind == "drift":
        steps = random.normal(size=shape)
        spread = 0.05 * size / np.cumsum(steps, axis=0).std(axis=0)
        return replace(made, outputs=made.outputs + np.cumsum(spread * steps, axis=0), walk=spread**2)
    if made.kind == "hum":
        tops = made.structure.frequencies / (2 * np.pi)
        hum = tops[0]
        while np.min(np.abs(tops / hum - 1)) < 0.05:
            hum = random.uniform(0.05, 0.45) * made.sample_rate
        phase = 2 * np.pi * hum * np.arange(len(made.outputs)) / made.sample_rate
        amplitude = random.uniform(0.02, 0.1) * np.sqrt(2) * size
        return replace(made, outputs=made.outputs + amplitude * np.sin(phase[:, None] + random.uniform(0, 6, shape[1])))
    if made.kind == "unmeasured_force":
        fast = made.sample_rate * made.over
        force = _excitation("noise", random, len(made.outputs), made.sample_rate, made.structure.frequencies, made.over)
        force /= force.std()
        shapes = made.structure.residues[:, 0] * random.normal(size=len(made.structure.frequencies))
        other = made.sampled(made.structure.modal_responses(force[:, None], 1 / fast), shapes[:, None])
        scale = random.uniform(0.03, 0.2) * np.min(size / other.std(axis=0))
        return replace(made, outputs=made.outputs + scale * other, other_force=scale * shapes)
    return made
