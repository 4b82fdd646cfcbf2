/* A steady-state model as sampled by narxcal: memoryless, the same inputs give the same outputs. */
#ifndef STEADY_H
#define STEADY_H

#include <stddef.h>

#include "sizes.h"

/* Variables by value reference: inputs, outputs, whether the inputs are inside the envelope. */
#define N_VARIABLES (N_IN + N_OUT + 1)
#define TIME_REFERENCE N_VARIABLES

typedef struct {
    double values[N_VARIABLES];
    int changed; /* an input was set since the outputs were computed */
    double time; /* FMI 3.0 lets its value be asked for */
} Steady;

void steady_restart(Steady *model);
/* 0 if all went well, 1 for a value reference that is none (or no input). */
int steady_set(Steady *model, const unsigned int *references, size_t count, const double *values);
int steady_get(Steady *model, const unsigned int *references, size_t count, double *values);

#endif
