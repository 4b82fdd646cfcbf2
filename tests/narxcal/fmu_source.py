"""A tiny FMU in C, compiled where the tests run.

`N1_pct` follows `20 + 0.9 TRA - 5 Mach` with a lag of 0.1 s; `ITT` is algebraic; an `Mach`
above 0.9 is an error of the FMU. The state survives until `reset`.
"""

import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

COMMON = r"""
#include <math.h>
#include <stdlib.h>
typedef struct { double v[4]; } M;
static void restart(M *m) { m->v[0] = m->v[1] = m->v[2] = m->v[3] = 0.0; }
static int run(M *m, double h) {
    if (m->v[1] > 0.9) return 3;
    m->v[2] += (20.0 + 0.9 * m->v[0] - 5.0 * m->v[1] - m->v[2]) * (1.0 - exp(-h / 0.1));
    m->v[3] = 300.0 + 4.0 * m->v[0];
    return 0;
}
"""

FMI2 = (
    COMMON
    + r"""
#include "fmi2Functions.h"
fmi2Component fmi2Instantiate(fmi2String n, fmi2Type t, fmi2String g, fmi2String r,
    const fmi2CallbackFunctions *f, fmi2Boolean v, fmi2Boolean l) { return calloc(1, sizeof(M)); }
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean td, fmi2Real t, fmi2Real s,
    fmi2Boolean sd, fmi2Real e) { return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { restart((M *)c); return fmi2OK; }
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n,
    const fmi2Real x[]) { for (size_t i = 0; i < n; i++) ((M *)c)->v[vr[i]] = x[i];
    return fmi2OK; }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real x[]) {
    for (size_t i = 0; i < n; i++) x[i] = ((M *)c)->v[vr[i]]; return fmi2OK; }
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean b) {
    return (fmi2Status)run((M *)c, h); }
"""
)

FMI3 = (
    COMMON
    + r"""
#include "fmi3Functions.h"
fmi3Instance fmi3InstantiateCoSimulation(fmi3String n, fmi3String g, fmi3String r, fmi3Boolean v,
    fmi3Boolean l, fmi3Boolean e, fmi3Boolean a, const fmi3ValueReference q[], size_t nq,
    fmi3InstanceEnvironment i, fmi3LogMessageCallback m, fmi3IntermediateUpdateCallback u) {
    return calloc(1, sizeof(M)); }
void fmi3FreeInstance(fmi3Instance c) { free(c); }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean td, fmi3Float64 t,
    fmi3Float64 s, fmi3Boolean sd, fmi3Float64 e) { return fmi3OK; }
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3Reset(fmi3Instance c) { restart((M *)c); return fmi3OK; }
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n,
    const fmi3Float64 x[], size_t nx) { for (size_t i = 0; i < n; i++) ((M *)c)->v[vr[i]] = x[i];
    return fmi3OK; }
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n,
    fmi3Float64 x[], size_t nx) { for (size_t i = 0; i < n; i++) x[i] = ((M *)c)->v[vr[i]];
    return fmi3OK; }
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean b,
    fmi3Boolean *ev, fmi3Boolean *te, fmi3Boolean *er, fmi3Float64 *last) {
    *ev = *te = *er = 0; *last = t + h; return (fmi3Status)run((M *)c, h); }
"""
)

XML2 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="deck" guid="{deck}">
<CoSimulation modelIdentifier="deck" canHandleVariableCommunicationStepSize="true"/>
<ModelVariables>
<ScalarVariable name="TRA_deg" valueReference="0" causality="input"><Real start="0"/>
</ScalarVariable>
<ScalarVariable name="Mach" valueReference="1" causality="input"><Real start="0"/></ScalarVariable>
<ScalarVariable name="N1_pct" valueReference="2" causality="output"><Real/></ScalarVariable>
<ScalarVariable name="ITT" valueReference="3" causality="output"><Real/></ScalarVariable>
<ScalarVariable name="mode" valueReference="4" causality="output" variability="discrete"><Integer/>
</ScalarVariable>
</ModelVariables>
<ModelStructure><Outputs><Unknown index="3"/><Unknown index="4"/><Unknown index="5"/></Outputs>
</ModelStructure></fmiModelDescription>
"""

XML3 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="deck" instantiationToken="{deck}">
<CoSimulation modelIdentifier="deck" canHandleVariableCommunicationStepSize="true"/>
<ModelVariables>
<Float64 name="time" valueReference="9" causality="independent" variability="continuous"/>
<Float64 name="TRA_deg" valueReference="0" causality="input" start="0"/>
<Float64 name="Mach" valueReference="1" causality="input" start="0"/>
<Float64 name="N1_pct" valueReference="2" causality="output"/>
<Float64 name="ITT" valueReference="3" causality="output"/>
</ModelVariables>
<ModelStructure><Output valueReference="2"/><Output valueReference="3"/></ModelStructure>
</fmiModelDescription>
"""

EXPECTED = "needs a C compiler and the extra fmu, for Linux"


def stubs(header, code):
    """Write every function of the standard that `code` lacks: FMPy insists on them all."""
    names = re.findall(r"FMI\d_Export\s+\w+\s+(\w+);", header.read_text(encoding="utf-8"))
    return "".join(f"int {name}(void) {{ return 3; }}\n" for name in names if name not in code)


def build(file, version):
    """Write a real FMU of FMI `version` 2 or 3 to `file`, or skip the test and say why."""
    fmpy = pytest.importorskip("fmpy", reason=EXPECTED, exc_type=ImportError)
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None or not sys.platform.startswith("linux"):
        pytest.skip(EXPECTED)
    headers = Path(fmpy.__path__[0]) / "c-code"
    source, library = file.with_suffix(".c"), file.with_suffix(".so")
    code = FMI3 if version == 3 else FMI2
    source.write_text(code, encoding="utf-8")
    others = file.with_name("others.c")
    others.write_text(stubs(headers / f"fmi{version}Functions.h", code), encoding="utf-8")
    command = [compiler, "-shared", "-fPIC", "-O1", "-w", f"-I{headers}", source, others]
    subprocess.run([*command, "-o", library, "-lm"], check=True)
    folder = fmpy.platform_tuple if version == 3 else fmpy.platform
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("modelDescription.xml", XML3 if version == 3 else XML2)
        archive.write(library, f"binaries/{folder}/deck.so")
    return file


def packed(file, description=XML2, members=()):
    """Write an archive with `description` and further `members`, runnable or not."""
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("modelDescription.xml", description)
        for name in members:
            archive.writestr(name, b"no library")
    return file
