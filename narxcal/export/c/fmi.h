/* A model of narxcal between the communication points of a co-simulation. */
#ifndef FMI_H
#define FMI_H

#include <stddef.h>

#include "engine.h"
#include "token.h"

/* Value references: inputs, outputs, ends of their intervals, flags, parameters, time. */
enum {
    REF_OUT = NARXCAL_INPUTS,
    REF_LOW = REF_OUT + NARXCAL_OUTPUTS,
    REF_HIGH = REF_LOW + NARXCAL_OUTPUTS,
    REF_INSIDE = REF_HIGH + NARXCAL_OUTPUTS,
    REF_HELD, REF_ENGINE, REF_INTERPOLATE, REF_TIME
};

/* Everything of an instance in one plain structure, so that a state is a copy of it. */
typedef struct {
    narxcal_state state;
    narxcal_outputs out;                 /* at `time` */
    double set[NARXCAL_INPUTS];          /* inputs as set last: those at the end of the next step */
    double before[NARXCAL_INPUTS];       /* inputs at `time` */
    unsigned char given[NARXCAL_INPUTS]; /* whether an input was set */
    unsigned char first[NARXCAL_INPUTS]; /* whether that was in initialisation */
    double start, time;
    double count;                        /* samples since the start */
    int engine, interpolate, started, fresh;
} instance;

void fmi_restart(instance *m);
void fmi_initialised(instance *m);
/* 0 if all went well, 1 for a value reference that is none of its kind, or a step backwards. */
int fmi_set(instance *m, unsigned int reference, double value);
int fmi_get(instance *m, unsigned int reference, double *value);
int fmi_step(instance *m, double time, double step);

#endif
