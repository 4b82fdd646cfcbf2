/* FMI 2.0 for co-simulation round a steady-state model (FMI specification 2.0.4, chapter 4). */
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "steady.h"

#define NOT_OFFERED { return fmi2Error; }
#define NONE_OF_THESE { return count ? fmi2Error : fmi2OK; }
#define REFERENCES fmi2Component c, const fmi2ValueReference r[], size_t count

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
    const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    if (type != fmi2CoSimulation || !guid || strcmp(guid, TOKEN)) return NULL;
    Steady *model = calloc(1, sizeof(Steady));
    if (model) steady_restart(model);
    return model;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2Reset(fmi2Component c) { steady_restart(c); return fmi2OK; }

fmi2Status fmi2SetReal(REFERENCES, const fmi2Real v[])
{
    return steady_set(c, r, count, v) ? fmi2Error : fmi2OK;
}
fmi2Status fmi2GetReal(REFERENCES, fmi2Real v[])
{
    return steady_get(c, r, count, v) ? fmi2Error : fmi2OK;
}

/* Nothing depends on time, so a step has nothing to do. */
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean final) { return fmi2OK; }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerant, fmi2Real tolerance,
    fmi2Real start, fmi2Boolean stops, fmi2Real stop) { return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2CancelStep(fmi2Component c) NOT_OFFERED
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n,
    const fmi2String categories[]) { return fmi2OK; }

/* All variables are real. */
fmi2Status fmi2GetInteger(REFERENCES, fmi2Integer v[]) NONE_OF_THESE
fmi2Status fmi2GetBoolean(REFERENCES, fmi2Boolean v[]) NONE_OF_THESE
fmi2Status fmi2GetString(REFERENCES, fmi2String v[]) NONE_OF_THESE
fmi2Status fmi2SetInteger(REFERENCES, const fmi2Integer v[]) NONE_OF_THESE
fmi2Status fmi2SetBoolean(REFERENCES, const fmi2Boolean v[]) NONE_OF_THESE
fmi2Status fmi2SetString(REFERENCES, const fmi2String v[]) NONE_OF_THESE

/* What modelDescription.xml does not announce. */
fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *s) NOT_OFFERED
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate s) NOT_OFFERED
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *s) NOT_OFFERED
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate s, size_t *n) NOT_OFFERED
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate s, fmi2Byte b[], size_t n) NOT_OFFERED
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte b[], size_t n, fmi2FMUstate *s)
    NOT_OFFERED
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference u[], size_t nu,
    const fmi2ValueReference k[], size_t nk, const fmi2Real dk[], fmi2Real du[]) NOT_OFFERED
fmi2Status fmi2SetRealInputDerivatives(REFERENCES, const fmi2Integer order[], const fmi2Real v[])
    NONE_OF_THESE
fmi2Status fmi2GetRealOutputDerivatives(REFERENCES, const fmi2Integer order[], fmi2Real v[])
    NONE_OF_THESE
fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind k, fmi2Status *v) NOT_OFFERED
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind k, fmi2Real *v) NOT_OFFERED
fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind k, fmi2Integer *v) NOT_OFFERED
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind k, fmi2Boolean *v) NOT_OFFERED
fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind k, fmi2String *v) NOT_OFFERED
