/* For the proof alone: many samples at once. A row is values, half-widths, inside, held. */
#include <stddef.h>

#include "engine.h"

void narxcal_many(narxcal_state *state, const double *inputs, size_t count, double *rows)
{
    narxcal_outputs out;
    for (size_t k = 0; k < count; k++) {
        narxcal_step(state, inputs + k * NARXCAL_INPUTS, &out);
        for (int o = 0; o < NARXCAL_OUTPUTS; o++) *rows++ = out.value[o];
        for (int o = 0; o < NARXCAL_OUTPUTS; o++) *rows++ = out.half_width[o];
        *rows++ = out.inside;
        *rows++ = out.held;
    }
}
