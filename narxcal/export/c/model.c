/* ---- the model: y = ss - sum of weighted deviations */

/* Half-width of the interval at a distance from the steady state; NaN where none is known. */
static double half_width(int o, double away)
{
    const double *x = widths_at + width_first[o], *w = widths + width_first[o];
    size_t count = width_count[o];
    if (count == 0) return NAN;
    if (away <= x[0]) return w[0];
    if (away >= x[count - 1]) return w[count - 1];
    size_t k = cell(x, count, away);
    return w[k] + (w[k + 1] - w[k]) * (away - x[k]) / (x[k + 1] - x[k]);
}

/* The sample of given inputs: what is not finite keeps its last value, and all within limits. */
static sample taken(narxcal_state *state, const double *inputs, int first)
{
    sample now;
    int within = 1;
    now.engine = state->engine;
    state->now.held = 0;
    for (int i = 0; i < NARXCAL_INPUTS; i++) {
        if (isfinite(inputs[i])) state->inputs[i] = inputs[i];
        else state->now.held = 1;
        now.in[i] = clip(state->inputs[i], reach_low[i], reach_high[i]);
        if (state->inputs[i] < now.in[i] || state->inputs[i] > now.in[i]) within = 0;
    }
#ifdef DELAY_ROWS
    if (first) delay_start(now.in, state->x + DELAY_AT);
    else delay_step(now.in, state->x + DELAY_AT);
#else
    (void)first;
#endif
    state->now.inside = steady(now.engine, now.in, now.ss) && within;
    return now;
}

static void shown(narxcal_state *state, const sample *now, const double *d)
{
    for (int o = 0; o < NARXCAL_OUTPUTS; o++) {
        state->now.value[o] = now->ss[o] - d[o];
        state->now.half_width[o] = half_width(o, fabs(now->ss[o] - state->now.value[o]));
    }
}

void narxcal_start(narxcal_state *state, int engine, const double *inputs, const double *measured)
{
    double d[NARXCAL_OUTPUTS];
    for (int i = 0; i < NARXCAL_INPUTS; i++) state->inputs[i] = start_inputs[i];
    for (int i = 0; i < NARXCAL_STATES; i++) state->x[i] = 0.0;
    state->engine = engine >= 0 && engine < NARXCAL_ENGINES ? engine : 0;
    const sample now = taken(state, inputs, 1);
    for (int o = 0; o < NARXCAL_OUTPUTS; o++)
        d[o] = measured && measured[o] >= measured_low[o] && measured[o] <= measured_high[o]
            ? now.ss[o] - measured[o] : 0.0;
    for (size_t k = 0; k < sizeof parts / sizeof *parts; k++)
        if (parts[k].start) parts[k].start(parts[k].p, &now, d, state->x + parts[k].at);
    shown(state, &now, d);
}

void narxcal_init(narxcal_state *state, const double *inputs)
{
    narxcal_start(state, 0, inputs, NULL);
}

void narxcal_step(narxcal_state *state, const double *inputs, narxcal_outputs *outputs)
{
    double total[NARXCAL_OUTPUTS] = {0.0}, d[NARXCAL_OUTPUTS];
    const sample now = taken(state, inputs, 0);
    for (size_t k = 0; k < sizeof parts / sizeof *parts; k++) {
        if (!parts[k].step) continue;
        parts[k].step(parts[k].p, &now, state->x + parts[k].at, d);
        for (int o = 0; o < NARXCAL_OUTPUTS; o++)
            if (parts[k].weights[o] != 0.0) total[o] += parts[k].weights[o] * d[o];
    }
    shown(state, &now, total);
    *outputs = state->now;
}
