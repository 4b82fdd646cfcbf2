/* FMI 2.0 for co-simulation round a model of narxcal (FMI specification 2.0.4, chapter 4). */
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "fmi.h"

#define NOT_OFFERED { return fmi2Error; }
#define NONE_OF_THESE { return count ? fmi2Error : fmi2OK; }
#define REFERENCES fmi2Component c, const fmi2ValueReference r[], size_t count

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
    const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    if (type != fmi2CoSimulation || !guid || strcmp(guid, TOKEN)) return NULL;
    instance *m = calloc(1, sizeof(instance));
    if (m) fmi_restart(m);
    return m;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2Reset(fmi2Component c) { fmi_restart(c); return fmi2OK; }

/* The engine is an integer, interpolation a boolean, all else is real. */
#define TYPE(T, WHERE) \
fmi2Status fmi2Set##T(REFERENCES, const fmi2##T v[]) \
{ \
    for (size_t k = 0; k < count; k++) \
        if (!(WHERE) || fmi_set(c, r[k], (double)v[k])) return fmi2Error; \
    return fmi2OK; \
} \
fmi2Status fmi2Get##T(REFERENCES, fmi2##T v[]) \
{ \
    for (size_t k = 0; k < count; k++) { \
        double value; \
        if (!(WHERE) || fmi_get(c, r[k], &value)) return fmi2Error; \
        v[k] = (fmi2##T)value; \
    } \
    return fmi2OK; \
}
TYPE(Real, r[k] < REF_ENGINE || r[k] == REF_TIME)
TYPE(Integer, r[k] == REF_ENGINE)
TYPE(Boolean, r[k] == REF_INTERPOLATE)

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean final)
{
    return fmi_step(c, t, h) ? fmi2Error : fmi2OK;
}
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerant, fmi2Real tolerance,
    fmi2Real start, fmi2Boolean stops, fmi2Real stop)
{
    ((instance *)c)->start = ((instance *)c)->time = start;
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { fmi_initialised(c); return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2CancelStep(fmi2Component c) NOT_OFFERED
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n,
    const fmi2String categories[]) { return fmi2OK; }

fmi2Status fmi2GetString(REFERENCES, fmi2String v[]) NONE_OF_THESE
fmi2Status fmi2SetString(REFERENCES, const fmi2String v[]) NONE_OF_THESE

/* A state is a copy of the instance. */
fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *s)
{
    if (!*s) *s = malloc(sizeof(instance));
    if (!*s) return fmi2Error;
    memcpy(*s, c, sizeof(instance));
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate s)
{
    memcpy(c, s, sizeof(instance));
    return fmi2OK;
}
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *s)
{
    free(*s);
    *s = NULL;
    return fmi2OK;
}
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate s, size_t *n)
{
    *n = sizeof(instance);
    return fmi2OK;
}
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate s, fmi2Byte b[], size_t n)
{
    if (n < sizeof(instance)) return fmi2Error;
    memcpy(b, s, sizeof(instance));
    return fmi2OK;
}
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte b[], size_t n, fmi2FMUstate *s)
{
    if (n != sizeof(instance) || fmi2GetFMUstate(c, s) != fmi2OK) return fmi2Error;
    memcpy(*s, b, n);
    return fmi2OK;
}

/* What modelDescription.xml does not announce. */
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
