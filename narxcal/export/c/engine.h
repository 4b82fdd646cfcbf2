@ABOUT@
#ifndef NARXCAL_ENGINE_H
#define NARXCAL_ENGINE_H

#define NARXCAL_RUN_SHA256 "@SHA256@"
#define NARXCAL_DT_S @DT_S@ /* s from sample to sample */
#define NARXCAL_STATES @STATES@
#define NARXCAL_MEMORY @MEMORY@ /* 0: a steady state alone */
#define NARXCAL_LEVEL @LEVEL@ /* share of samples within the interval */

@NAMES@

/* Envelope of the steady state; outside, it is evaluated at the nearest conditions inside. */
@BOUNDS@

typedef struct {
    double value[NARXCAL_OUTPUTS];
    double half_width[NARXCAL_OUTPUTS]; /* of the interval; NaN where none is known */
    int inside; /* whether the inputs are inside the envelope */
    int held;   /* whether an input was not finite, so that its last value was used */
} narxcal_outputs;

/* All that lasts from sample to sample: may be copied and stored. */
typedef struct {
    double inputs[NARXCAL_INPUTS];
    double x[NARXCAL_STATES];
    narxcal_outputs now; /* of the newest sample */
    int engine;
} narxcal_state;

/* Begin in equilibrium at the inputs; state->now has the outputs. */
void narxcal_init(narxcal_state *state, const double *inputs);

/* Begin with an engine of the list above at measured outputs; in equilibrium where one is NaN or
 * outside its physical range, or NULL is given. */
void narxcal_start(narxcal_state *state, int engine, const double *inputs, const double *measured);

/* Advance by NARXCAL_DT_S to the sample of these inputs, and give its outputs. */
void narxcal_step(narxcal_state *state, const double *inputs, narxcal_outputs *outputs);

#endif
