# SPDX-License-Identifier: Apache-2.0
"""A controller as a unit for co-simulation (FMI 2.0), which Simulink, Modelica tools and others take.

The unit holds the C99 sources and, compiled from them by this machine's C compiler, the library for it.
"""

from __future__ import annotations

import hashlib
import os
import re
import shlex
import shutil
import subprocess
import tempfile
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

from abrace_core import AbraceError
from abrace_core.files.writing import write_atomically
from abrace_lqg.export.c_sources import c_sources, source

if TYPE_CHECKING:
    from abrace_core.model.controller_file import Controller

PLATFORM = "linux64"
"""The folder of FMI 2.0 for this platform's library."""
FLAGS = ("-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden")


def write_fmu(controller: Controller, path: Path | str, rate_limit: float, ramp_time: float) -> None:
    """Write the unit.

    Parameters
    ----------
    controller, rate_limit, ramp_time
        As for `c_sources`.
    path
        Of the .fmu file.

    Raises
    ------
    AbraceError
        If a limit cannot be used, there is no C compiler, or the file cannot be written.
    """
    sources = {**c_sources(controller, rate_limit, ramp_time), "fmu.c": source("fmu.c")}
    compiled = [name for name in sources if name.endswith(".c")]
    identifier = re.sub(r"\W", "_", f"abrace_{controller.name}", flags=re.ASCII)
    description = _description(controller, identifier, sources, compiled)
    with tempfile.TemporaryDirectory(prefix="abrace_fmu_") as folder:
        for name, text in sources.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        library = Path(folder) / f"{identifier}.so"
        _compile([Path(folder) / name for name in compiled], library)
        with write_atomically(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as unit_file:
            unit_file.writestr("modelDescription.xml", description)
            unit_file.write(library, f"binaries/{PLATFORM}/{library.name}")
            for name, text in sources.items():
                unit_file.writestr(f"sources/{name}", text)


def _compile(sources: list[Path], library: Path) -> None:
    compiler = shlex.split(os.environ.get("CC", "cc"))
    if not compiler or shutil.which(compiler[0]) is None:
        raise AbraceError(f"no C compiler {' '.join(compiler)!r}, expected one to compile the unit, or its name in CC")
    ended = subprocess.run(
        [*compiler, *FLAGS, "-o", str(library), *map(str, sources), "-lm"], capture_output=True, text=True, check=False
    )
    if ended.returncode:
        raise AbraceError(f"{' '.join(compiler)} cannot compile the unit: {ended.stderr.strip().splitlines()[-1]}")


def _description(controller: Controller, identifier: str, sources: dict[str, str], compiled: list[str]) -> str:
    """modelDescription.xml of FMI 2.0."""
    law = controller.law
    guid = hashlib.sha256("".join(sources.values()).encode()).hexdigest()[:32]
    names = (*law.inputs, *law.outputs)
    by_name = {name: law.unit(name) for name in names}
    units = sorted(set(by_name.values()))
    variables = [_real(name, by_name[name], i, "input") for i, name in enumerate(law.inputs)]
    variables += [_real(name, by_name[name], len(law.inputs) + i, "output") for i, name in enumerate(law.outputs)]
    outputs = range(len(law.inputs) + 1, len(names) + 2)
    known = "".join(f'<Unknown index="{index}"/>' for index in outputs)
    factors = {"m": 'm="1"', "m/s^2": 'm="1" s="-2"', "N": 'kg="1" m="1" s="-2"', "-": ""}
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<fmiModelDescription fmiVersion="2.0" modelName={quoteattr(controller.name)} guid="{guid}"',
        f'  generationTool="abrace" description={quoteattr("Made from: " + controller.model)}>',
        f'<CoSimulation modelIdentifier="{identifier}" canHandleVariableCommunicationStepSize="false">',
        "<SourceFiles>" + "".join(f'<File name="{name}"/>' for name in compiled) + "</SourceFiles>",
        "</CoSimulation>",
        "<UnitDefinitions>",
        *(
            f"<Unit name={quoteattr(name)}><BaseUnit {factors[name]}/></Unit>"
            if name in factors
            else f"<Unit name={quoteattr(name)}/>"
            for name in units
        ),
        "</UnitDefinitions>",
        f'<DefaultExperiment startTime="0" stepSize="{controller.rig_period!r}"/>',
        "<ModelVariables>",
        *variables,
        '<ScalarVariable name="stopped" valueReference="0" causality="output" variability="discrete"',
        '  description="a value was not finite: the force goes to zero and stays there"><Boolean/></ScalarVariable>',
        "</ModelVariables>",
        f"<ModelStructure><Outputs>{known}</Outputs><InitialUnknowns>{known}</InitialUnknowns></ModelStructure>",
        "</fmiModelDescription>",
    ]
    return "\n".join(lines) + "\n"


def _real(name: str, unit: str, number: int, causality: str) -> str:
    start = ' start="0"' if causality == "input" else ""
    return (
        f'<ScalarVariable name={quoteattr(name)} valueReference="{number}" causality="{causality}" '
        f'variability="discrete"><Real unit={quoteattr(unit)}{start}/></ScalarVariable>'
    )
