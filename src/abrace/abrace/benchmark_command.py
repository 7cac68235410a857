# SPDX-License-Identifier: Apache-2.0
"""`abrace benchmark`: a controller on a benchmark building or rig, compared with the reference controllers."""

from __future__ import annotations

import json
import re
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterable, Sequence

    from abrace.benchmark.comparison import Evaluation
    from abrace.benchmark.definition import RecordedCase
    from abrace.benchmark.frame_benchmark import FrameBenchmark
    from abrace.benchmark.laws import AnyBenchmark
    from abrace_core.command_line import OneLineParser

RESULTS = Path("results/benchmark")
RECORDED = "recorded"
"""Name of the test that --bag gives, among controllers."""
EXAMPLES = """examples:
  abrace benchmark ncree_three_storey                          LQG1 to LQG5: results/benchmark/ncree_three_storey
  abrace benchmark ncree_three_storey --controller mine.yaml   and a controller file
  abrace benchmark ncree_three_storey --controller skyhook/skyhook   a node, in the live graph in lockstep
  abrace benchmark ncree_three_storey --bag bags/lqg3 --uncontrolled bags/free   a recorded test
  BENCHMARK_DATA=folder abrace benchmark sac_la_20 --controller mine.yaml        with the records in folder/records
  abrace benchmark sac_la_20 --record el_centro                any record, with its own uncontrolled values
  abrace benchmark ncree_three_storey --export shared          model, motions and laws for other programs"""
RIG_PEAK = 0.980665
"""Of a record given for a rig, or for a rig without a benchmark file: 0.1 g [m/s^2]."""


def add_benchmark_parser(
    commands: argparse._SubParsersAction[OneLineParser],
    completed: Callable[[argparse.Action], None],
) -> None:
    """Add `benchmark` to the command's `commands`; `completed` has the shell complete its name."""
    benchmark = commands.add_parser(
        "benchmark",
        help="criteria J1 to J17 of a controller on a benchmark, compared with reference controllers",
        epilog=EXAMPLES,
    )
    completed(
        benchmark.add_argument("name", help="a benchmark or a rig, by name or file: sac_la_20, ncree_three_storey")
    )
    benchmark.add_argument(
        "--controller",
        action="append",
        default=[],
        metavar="FILE|NODE",
        help="controller file, PACKAGE/EXECUTABLE or Python file of a law; may be given several times",
    )
    benchmark.add_argument(
        "--record",
        action="append",
        default=[],
        metavar="RECORD",
        help="name or file, instead of the benchmark's: as recorded, a rig's at 0.1 g; may be given several times",
    )
    benchmark.add_argument(
        "--bag", metavar="BAG", help="a recorded test of the rig; the controllers are run under the motion of its table"
    )
    benchmark.add_argument("--uncontrolled", metavar="BAG", help="the same motion of the table with zero command")
    benchmark.add_argument(
        "--noise", type=int, metavar="SEED", help="run a frame's sensors with the benchmark's noise, of this seed"
    )
    benchmark.add_argument(
        "--trade-off",
        action="store_true",
        help="also draw responses and margins of abrace's own law over force, on a frame",
    )
    benchmark.add_argument(
        "--export", type=Path, metavar="FOLDER", help="only write model, motions and laws into this folder"
    )


def benchmark_command(given: argparse.Namespace) -> None:
    """Carry out `abrace benchmark` with the arguments `given`."""
    from abrace.benchmark.export import export_benchmark
    from abrace.benchmark.frame_benchmark import FrameBenchmark

    if (given.bag is None) != (given.uncontrolled is None):
        raise AbraceError("benchmark: --bag and --uncontrolled, expected both or neither")
    if given.bag is not None and given.record:
        raise AbraceError(
            "--record: given with --bag, expected controllers to be run under the motion of the bag's table"
        )
    if given.noise is not None and given.noise < 0:
        raise AbraceError(f"--noise: {given.noise}, expected a seed from 0 on")
    if given.trade_off and given.bag is not None:
        raise AbraceError("--trade-off: given with --bag, expected the benchmark's own motions")
    benchmark = open_benchmark(given.name, given.record, given.noise)
    if given.trade_off and not isinstance(benchmark, FrameBenchmark):
        raise AbraceError(
            "--trade-off: given with a rig, expected a benchmark of a frame (for a rig: the node explore)"
        )
    folder = RESULTS / benchmark.definition.name
    if given.export is not None:
        for path in export_benchmark(benchmark, given.export):
            print(f"wrote {path}")
        return
    test = None if given.bag is None else _recorded(benchmark, given)
    cases: Sequence[Any] = benchmark.definition.cases if test is None else (test.case,)
    own = list(_given_ones(benchmark, given, folder, cases))
    references = _references(benchmark, cases)
    evaluations = [*(() if test is None else (test.evaluation,)), *own, *references]
    if not evaluations:
        raise AbraceError(f"benchmark {given.name}: no reference controller, expected --controller or --bag")
    further = []
    if given.trade_off and isinstance(benchmark, FrameBenchmark):
        further = [_trade_off(benchmark, references, folder)]
    print(_write(benchmark, evaluations, folder, further, cases))
    print(f"wrote {folder / 'report.html'}")


def open_benchmark(name: str, records: Iterable[str] = (), noise_seed: int | None = None) -> AnyBenchmark:
    """A benchmark, or a rig as one, by name or file.

    Parameters
    ----------
    name
        Of a benchmark file, or of a rig file.
    records
        Instead of the benchmark's.
    noise_seed
        Of a frame's sensors; None: no noise.

    Raises
    ------
    AbraceError
        If there is none of that name, or its file is wrong.
    """
    from abrace.benchmark.definition import Case, RigCase, RigDefinition, is_benchmark, load_definition
    from abrace.benchmark.frame_benchmark import FrameBenchmark
    from abrace.benchmark.rig_benchmark import RigBenchmark

    records = list(records)
    if is_benchmark(name):
        definition = load_definition(name)
    else:
        case = RigCase(record="el_centro", peak_acceleration=RIG_PEAK)
        plain = re.sub(r"[^A-Za-z0-9]+", "_", Path(name).stem).strip("_") or "rig"
        definition = RigDefinition(name=plain[:64], rig=name, duration=100.0, cases=[case])
    if isinstance(definition, RigDefinition):
        if noise_seed is not None:
            raise AbraceError("--noise: given with a rig, expected a benchmark of a frame; a rig's has no sensor noise")
        if records:
            cases = [RigCase(record=record, peak_acceleration=RIG_PEAK) for record in records]
            definition = definition.model_copy(update={"cases": cases})
        return RigBenchmark(definition)
    if records:
        own = [Case(record=record, intensity=1.0) for record in records]
        definition = definition.model_copy(update={"cases": own})
    return FrameBenchmark(definition, noise_seed)


class _RecordedTest(NamedTuple):
    """The test that --bag gives: its criteria, and its motion as a case."""

    evaluation: Evaluation
    case: RecordedCase


def _recorded(benchmark: AnyBenchmark, given: argparse.Namespace) -> _RecordedTest:
    """The test in a bag; J16 and J17 are those of the controller of its name among the files that were `given`."""
    from abrace.benchmark.comparison import Evaluation
    from abrace.benchmark.live import is_node
    from abrace.benchmark.recorded import of_tests, recorded_case
    from abrace_bags import read_run
    from abrace_core.controller_file import load_controller

    run, free = read_run(given.bag), read_run(given.uncontrolled)
    case = recorded_case(benchmark, run, Path(given.bag).name)
    used = Path(run.facts.get("controller", "")).stem
    laws = [load_controller(one).law for one in given.controller if not is_node(one) and Path(one).stem == used]
    found = {case.name: of_tests(benchmark, run, free, laws[0] if laws else None)}
    return _RecordedTest(Evaluation.of(RECORDED, found, benchmark.layout), case)


def _given_ones(
    benchmark: AnyBenchmark, given: argparse.Namespace, folder: Path, cases: Sequence[Any]
) -> Iterable[Evaluation]:
    """The controllers and nodes that were asked for."""
    from abrace.benchmark.comparison import Evaluation
    from abrace.benchmark.laws import margins_of
    from abrace.benchmark.live import is_node, run_live
    from abrace_core.controller_file import load_controller

    for one, name in zip(given.controller, _names_of(benchmark, given), strict=True):
        if is_node(one):
            if given.bag is not None:
                raise AbraceError(f"--controller {one}: a node, given with --bag, expected controller files")
            yield Evaluation.of(name, run_live(benchmark, one, folder), benchmark.layout)
            continue
        controller = load_controller(one)
        found = benchmark.evaluate(controller, cases)
        yield Evaluation.of(name, found, benchmark.layout, margins_of(benchmark, controller))


def _names_of(benchmark: AnyBenchmark, given: argparse.Namespace) -> list[str]:
    """A different name for each controller `given`: its file's name, with the path where that name is taken."""
    from abrace.benchmark.laws import reference_names

    others = [*reference_names(benchmark), *([RECORDED] if given.bag is not None else [])]
    stems = [Path(one).stem for one in given.controller]
    uses = Counter([*others, *stems])
    names = [stem if uses[stem] == 1 else f"{stem} ({one})" for stem, one in zip(stems, given.controller, strict=True)]
    twice = [name for name, count in Counter([*others, *names]).items() if count > 1]
    if twice:
        raise AbraceError(f"--controller: {twice[0]} twice, expected each controller once")
    return names


def _references(benchmark: AnyBenchmark, cases: Sequence[Any]) -> list[Evaluation]:
    from abrace.benchmark.comparison import Evaluation
    from abrace.benchmark.laws import margins_of, references

    return [
        Evaluation.of(name, benchmark.evaluate(law, cases), benchmark.layout, margins_of(benchmark, law))
        for name, law in references(benchmark).items()
    ]


def _trade_off(benchmark: FrameBenchmark, references: list[Evaluation], folder: Path) -> Path:
    """Draw what more force would give, with the sample controller of the `references`; returns the figure's path."""
    from abrace.benchmark.laws import SAMPLE
    from abrace.benchmark.trade_off import trade_off, trade_off_figure
    from abrace_core.drawing import save_figure

    (sample,) = (one for one in references if one.name == SAMPLE)
    path = folder / "trade_off.png"
    save_figure(trade_off_figure(benchmark, trade_off(benchmark), sample), path)
    return path


def _write(
    benchmark: AnyBenchmark,
    evaluations: list[Evaluation],
    folder: Path,
    further: Sequence[Path],
    cases: Sequence[Any],
) -> str:
    """Write criteria.json, figures, report.html and report.md; returns the table as text."""
    from abrace.benchmark.comparison import Profile, case_tables, uncontrolled_table, worst_table
    from abrace.benchmark.figures import criteria_figure, profile_figure
    from abrace.report.page import page
    from abrace.report.sections import Picture, Section, markdown
    from abrace_core.drawing import save_figure
    from abrace_core.files import write_text

    name = benchmark.definition.name
    table, tables = worst_table(f"Benchmark {name}", evaluations), case_tables(evaluations)
    free = uncontrolled_table({case.name: benchmark.uncontrolled(case) for case in cases})
    content: dict[str, Any] = {one.name: {"cases": one.cases, "margins": one.margins} for one in evaluations}
    save_figure(criteria_figure(name, evaluations), folder / "criteria.png")
    pictures = [Picture(folder / "criteria.png")]
    for i, case in enumerate(cases, 1):
        shown = [one for one in evaluations if case.name in one.profiles]
        if not shown:
            continue
        still = Profile.of(benchmark.without_control(case), benchmark.layout)
        path = folder / f"profile_{i}.png"
        save_figure(profile_figure(name, case.name, still, shown), path)
        pictures.append(Picture(path))
    sections = [
        Section("Criteria", (table, pictures[0])),
        Section("Over the height", tuple(pictures[1:])),
        Section("Response and force", tuple(Picture(path) for path in further)),
        Section("Each case", (*tables, free)),
    ]
    sections = [section for section in sections if section.parts]
    write_text(folder / "criteria.json", json.dumps(content, indent=1) + "\n")
    write_text(folder / "report.md", markdown(f"Benchmark {name}", sections, folder))
    write_text(folder / "report.html", page(f"Benchmark {name}", "docs/benchmarks.md says what each row is", sections))
    return table.text()
