/* The model's own grid of samples within any communication step. */
#include <math.h>

#include "fmi.h"

void fmi_restart(instance *m)
{
    static const instance nothing;
    *m = nothing;
    for (int i = 0; i < NARXCAL_INPUTS; i++) m->set[i] = NAN;
    narxcal_start(&m->state, 0, m->set, NULL);
    for (int i = 0; i < NARXCAL_INPUTS; i++) m->set[i] = m->before[i] = m->state.inputs[i];
}

void fmi_initialised(instance *m)
{
    for (int i = 0; i < NARXCAL_INPUTS; i++) m->first[i] = m->given[i];
}

int fmi_set(instance *m, unsigned int reference, double value)
{
    m->fresh = 0;
    if (reference < NARXCAL_INPUTS) {
        m->set[reference] = value;
        m->given[reference] = 1;
        /* What was constant before the first step is known by the first step at the latest. */
        if (!m->started && !m->first[reference]) m->before[reference] = value;
        return 0;
    }
    if (reference == REF_ENGINE && !m->started && value >= 0.0 && value < NARXCAL_ENGINES)
        m->engine = (int)value;
    else if (reference == REF_INTERPOLATE) m->interpolate = value != 0.0;
    else return 1;
    return 0;
}

/* Outputs at `time`: on a sample those of the model, between two those on the line to the next
 * sample, which is looked ahead for with the present inputs. */
static void refresh(instance *m)
{
    const double now = m->start + m->count * NARXCAL_DT_S, rest = (m->time - now) / NARXCAL_DT_S;
    if (!m->started) {
        narxcal_start(&m->state, m->engine, NARXCAL_MEMORY ? m->before : m->set, NULL);
        m->out = m->state.now;
    } else if (!NARXCAL_MEMORY) {
        narxcal_step(&m->state, m->set, &m->out);
    } else {
        m->out = m->state.now;
        if (rest > 1e-6) {
            narxcal_state ahead = m->state;
            narxcal_outputs next;
            narxcal_step(&ahead, m->set, &next);
            for (int o = 0; o < NARXCAL_OUTPUTS; o++) {
                m->out.value[o] += rest * (next.value[o] - m->out.value[o]);
                m->out.half_width[o] += rest * (next.half_width[o] - m->out.half_width[o]);
            }
            m->out.inside = next.inside;
            m->out.held = next.held;
        }
    }
    m->fresh = 1;
}

int fmi_get(instance *m, unsigned int reference, double *value)
{
    if (!m->fresh) refresh(m);
    if (reference < REF_OUT) *value = m->set[reference];
    else if (reference < REF_LOW) *value = m->out.value[reference - REF_OUT];
    else if (reference < REF_HIGH)
        *value = m->out.value[reference - REF_LOW] - m->out.half_width[reference - REF_LOW];
    else if (reference < REF_INSIDE)
        *value = m->out.value[reference - REF_HIGH] + m->out.half_width[reference - REF_HIGH];
    else if (reference == REF_INSIDE) *value = m->out.inside;
    else if (reference == REF_HELD) *value = m->out.held;
    else if (reference == REF_ENGINE) *value = m->engine;
    else if (reference == REF_INTERPOLATE) *value = m->interpolate;
    else if (reference == REF_TIME) *value = m->time;
    else return 1;
    return 0;
}

int fmi_step(instance *m, double time, double step)
{
    if (!(step >= 0.0)) return 1;
    if (!m->started) {
        narxcal_start(&m->state, m->engine, m->before, NULL);
        m->start = time;
        m->count = 0.0;
        m->started = 1;
    }
    const double end = time + step;
    double next = m->start + (m->count + 1.0) * NARXCAL_DT_S;
    for (; NARXCAL_MEMORY && next <= end + 1e-6 * NARXCAL_DT_S; next += NARXCAL_DT_S) {
        double in[NARXCAL_INPUTS], share = 1.0;
        if (m->interpolate && step > 0.0) share = fmin(fmax((next - time) / step, 0.0), 1.0);
        for (int i = 0; i < NARXCAL_INPUTS; i++)
            in[i] = share < 1.0 ? m->before[i] + share * (m->set[i] - m->before[i]) : m->set[i];
        narxcal_step(&m->state, in, &m->out);
        m->count += 1.0;
        next = m->start + m->count * NARXCAL_DT_S;
    }
    for (int i = 0; i < NARXCAL_INPUTS; i++) m->before[i] = m->set[i];
    m->time = end;
    m->fresh = 0;
    return 0;
}
