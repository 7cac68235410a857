# SPDX-License-Identifier: Apache-2.0
"""`abrace benchmark`: a controller on a benchmark building or rig, compared with the reference controllers."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from abrace_core import AbraceError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from abrace_core.files.command_line import OneLineParser
    from abrace_studies.benchmark.comparison import Evaluation
    from abrace_studies.benchmark.laws import AnyBenchmark

RESULTS = Path("results/benchmark")
EXAMPLES = """examples:
  abrace benchmark ncree_three_storey                          LQG1 to LQG5: results/benchmark/ncree_three_storey
  abrace benchmark ncree_three_storey --controller mine.yaml   and a controller file
  BENCHMARK_DATA=folder abrace benchmark sac_la_20 --controller mine.yaml        with the records in folder/records
  abrace benchmark sac_la_20 --record el_centro                any record, with its own uncontrolled values"""


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
    benchmark.set_defaults(act=benchmark_command)
    completed(
        benchmark.add_argument("name", help="a benchmark or a rig, by name or file: sac_la_20, ncree_three_storey")
    )
    benchmark.add_argument(
        "--controller",
        action="append",
        default=[],
        metavar="FILE",
        help="controller file; may be given several times",
    )
    benchmark.add_argument(
        "--record",
        action="append",
        default=[],
        metavar="RECORD",
        help="name or file, instead of the benchmark's: as recorded, a rig's at 0.1 g; may be given several times",
    )


def benchmark_command(given: argparse.Namespace) -> None:
    """Carry out `abrace benchmark` with the arguments `given`."""
    from abrace_core.model.controller_file import load_controller
    from abrace_studies.benchmark.comparison import Evaluation
    from abrace_studies.benchmark.laws import margins_of, reference_names, references
    from abrace_studies.benchmark.opening import open_benchmark

    benchmark = open_benchmark(given.name, given.record)
    names = _names_of(given.controller, reference_names(benchmark))
    tried = dict(zip(names, map(load_controller, given.controller), strict=True)) | references(benchmark)
    if not tried:
        raise AbraceError(f"benchmark {given.name}: no reference controller, expected --controller")
    evaluations = [Evaluation(name, benchmark.evaluate(law), margins_of(benchmark, law)) for name, law in tried.items()]
    folder = RESULTS / benchmark.definition.name
    print(_write(benchmark, evaluations, folder))
    print(f"wrote {folder / 'report.html'}")


def _names_of(files: list[str], references: tuple[str, ...]) -> list[str]:
    """A different name for each controller file: its own, with the path where another has that name."""
    stems = [Path(one).stem for one in files]
    uses = Counter([*references, *stems])
    names = [stem if uses[stem] == 1 else f"{stem} ({one})" for stem, one in zip(stems, files, strict=True)]
    twice = [name for name, count in Counter([*references, *names]).items() if count > 1]
    if twice:
        raise AbraceError(f"--controller: {twice[0]} twice, expected each controller once")
    return names


def _write(benchmark: AnyBenchmark, evaluations: list[Evaluation], folder: Path) -> str:
    """Write criteria.json and report.html; returns the table as text."""
    from abrace.benchmark_tables import case_tables, uncontrolled_table, worst_table
    from abrace.report.page import page
    from abrace.report.sections import Section
    from abrace_core.files.writing import write_json, write_text

    title, cases = f"Benchmark {benchmark.definition.name}", benchmark.definition.cases
    table = worst_table(title, evaluations)
    free = uncontrolled_table({case.name: benchmark.uncontrolled(case) for case in cases})  # type: ignore[arg-type]
    sections = [Section("Criteria", (table,)), Section("Each case", (*case_tables(evaluations), free))]
    write_json(
        folder / "criteria.json", {one.name: {"cases": one.cases, "margins": one.margins} for one in evaluations}
    )
    write_text(folder / "report.html", page(title, "docs/compare.md says what each row is", sections))
    return table.text()
