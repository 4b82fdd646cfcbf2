/* FMI 3.0 for co-simulation round a model of narxcal (FMI specification 3.0.2, chapter 4). */
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"
#include "fmi.h"

#define NOT_OFFERED { return fmi3Error; }
#define NONE_OF_THESE { return count ? fmi3Error : fmi3OK; }
#define REFERENCES fmi3Instance c, const fmi3ValueReference r[], size_t count

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
    fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
    const fmi3ValueReference intermediate[], size_t n, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    if (!token || strcmp(token, TOKEN)) return NULL;
    instance *m = calloc(1, sizeof(instance));
    if (m) fmi_restart(m);
    return m;
}
fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
    fmi3Boolean visible, fmi3Boolean logging, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log) { return NULL; }
fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token,
    fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3ClockUpdateCallback update,
    fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock) { return NULL; }
void fmi3FreeInstance(fmi3Instance c) { free(c); }
fmi3Status fmi3Reset(fmi3Instance c) { fmi_restart(c); return fmi3OK; }

/* The engine is an integer, interpolation a boolean, all else is real. */
#define TYPE(T, WHERE) \
fmi3Status fmi3Set##T(REFERENCES, const fmi3##T v[], size_t n) \
{ \
    if (n != count) return fmi3Error; \
    for (size_t k = 0; k < count; k++) \
        if (!(WHERE) || fmi_set(c, r[k], (double)v[k])) return fmi3Error; \
    return fmi3OK; \
} \
fmi3Status fmi3Get##T(REFERENCES, fmi3##T v[], size_t n) \
{ \
    if (n != count) return fmi3Error; \
    for (size_t k = 0; k < count; k++) { \
        double value; \
        if (!(WHERE) || fmi_get(c, r[k], &value)) return fmi3Error; \
        v[k] = (fmi3##T)value; \
    } \
    return fmi3OK; \
}
TYPE(Float64, r[k] < REF_ENGINE || r[k] == REF_TIME)
TYPE(Int32, r[k] == REF_ENGINE)
TYPE(Boolean, r[k] == REF_INTERPOLATE)

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean final,
    fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last)
{
    *event = *terminate = *early = fmi3False;
    if (fmi_step(c, t, h)) return fmi3Error;
    *last = ((instance *)c)->time;
    return fmi3OK;
}
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean tolerant, fmi3Float64 tolerance,
    fmi3Float64 start, fmi3Boolean stops, fmi3Float64 stop)
{
    ((instance *)c)->start = ((instance *)c)->time = start;
    return fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { fmi_initialised(c); return fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n,
    const fmi3String categories[]) { return fmi3OK; }

#define NO_TYPE(T) \
    fmi3Status fmi3Get##T(REFERENCES, fmi3##T v[], size_t n) NONE_OF_THESE \
    fmi3Status fmi3Set##T(REFERENCES, const fmi3##T v[], size_t n) NONE_OF_THESE
NO_TYPE(Float32) NO_TYPE(Int8) NO_TYPE(UInt8) NO_TYPE(Int16) NO_TYPE(UInt16) NO_TYPE(UInt32)
NO_TYPE(Int64) NO_TYPE(UInt64) NO_TYPE(String)
fmi3Status fmi3GetBinary(REFERENCES, size_t s[], fmi3Binary v[], size_t n) NONE_OF_THESE
fmi3Status fmi3SetBinary(REFERENCES, const size_t s[], const fmi3Binary v[], size_t n) NONE_OF_THESE
fmi3Status fmi3GetClock(REFERENCES, fmi3Clock v[]) NONE_OF_THESE
fmi3Status fmi3SetClock(REFERENCES, const fmi3Clock v[]) NONE_OF_THESE

/* A state is a copy of the instance. */
fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *s)
{
    if (!*s) *s = malloc(sizeof(instance));
    if (!*s) return fmi3Error;
    memcpy(*s, c, sizeof(instance));
    return fmi3OK;
}
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState s)
{
    memcpy(c, s, sizeof(instance));
    return fmi3OK;
}
fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *s)
{
    free(*s);
    *s = NULL;
    return fmi3OK;
}
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState s, size_t *n)
{
    *n = sizeof(instance);
    return fmi3OK;
}
fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState s, fmi3Byte b[], size_t n)
{
    if (n < sizeof(instance)) return fmi3Error;
    memcpy(b, s, sizeof(instance));
    return fmi3OK;
}
fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte b[], size_t n, fmi3FMUState *s)
{
    if (n != sizeof(instance) || fmi3GetFMUState(c, s) != fmi3OK) return fmi3Error;
    memcpy(*s, b, n);
    return fmi3OK;
}

/* What modelDescription.xml does not announce. */
fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance c, fmi3ValueReference r, size_t *n)
    NOT_OFFERED
fmi3Status fmi3GetVariableDependencies(fmi3Instance c, fmi3ValueReference r, size_t e[],
    fmi3ValueReference i[], size_t ei[], fmi3DependencyKind k[], size_t n) NOT_OFFERED
#define DERIVATIVE (fmi3Instance c, const fmi3ValueReference u[], size_t nu, \
    const fmi3ValueReference k[], size_t nk, const fmi3Float64 seed[], size_t ns, \
    fmi3Float64 s[], size_t n) NOT_OFFERED
fmi3Status fmi3GetDirectionalDerivative DERIVATIVE
fmi3Status fmi3GetAdjointDerivative DERIVATIVE
fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) NOT_OFFERED
fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) NOT_OFFERED
fmi3Status fmi3EnterEventMode(fmi3Instance c) NOT_OFFERED
fmi3Status fmi3EnterStepMode(fmi3Instance c) NOT_OFFERED
fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) NOT_OFFERED
fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance c) NOT_OFFERED
fmi3Status fmi3GetIntervalDecimal(REFERENCES, fmi3Float64 v[], fmi3IntervalQualifier q[])
    NONE_OF_THESE
fmi3Status fmi3GetIntervalFraction(REFERENCES, fmi3UInt64 v[], fmi3UInt64 w[],
    fmi3IntervalQualifier q[]) NONE_OF_THESE
fmi3Status fmi3GetShiftDecimal(REFERENCES, fmi3Float64 v[]) NONE_OF_THESE
fmi3Status fmi3GetShiftFraction(REFERENCES, fmi3UInt64 v[], fmi3UInt64 w[]) NONE_OF_THESE
fmi3Status fmi3SetIntervalDecimal(REFERENCES, const fmi3Float64 v[]) NONE_OF_THESE
fmi3Status fmi3SetIntervalFraction(REFERENCES, const fmi3UInt64 v[], const fmi3UInt64 w[])
    NONE_OF_THESE
fmi3Status fmi3SetShiftDecimal(REFERENCES, const fmi3Float64 v[]) NONE_OF_THESE
fmi3Status fmi3SetShiftFraction(REFERENCES, const fmi3UInt64 v[], const fmi3UInt64 w[])
    NONE_OF_THESE
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *a, fmi3Boolean *b, fmi3Boolean *d,
    fmi3Boolean *e, fmi3Boolean *f, fmi3Float64 *next) NOT_OFFERED
fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean final, fmi3Boolean *event,
    fmi3Boolean *terminate) NOT_OFFERED
fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 t) NOT_OFFERED
fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) NOT_OFFERED
#define STATES (fmi3Instance c, fmi3Float64 x[], size_t n) NOT_OFFERED
fmi3Status fmi3GetContinuousStateDerivatives STATES
fmi3Status fmi3GetEventIndicators STATES
fmi3Status fmi3GetContinuousStates STATES
fmi3Status fmi3GetNominalsOfContinuousStates STATES
fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) NOT_OFFERED
fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) NOT_OFFERED
fmi3Status fmi3GetOutputDerivatives(REFERENCES, const fmi3Int32 o[], fmi3Float64 v[], size_t n)
    NONE_OF_THESE
fmi3Status fmi3ActivateModelPartition(fmi3Instance c, fmi3ValueReference r, fmi3Float64 t)
    NOT_OFFERED
