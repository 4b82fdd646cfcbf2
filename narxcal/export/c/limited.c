/* ---- lags whose spools return to equilibrium by themselves, no faster than schedules allow */

#define OF(name) p[LIMITED_##name]
#define COLUMNS(way) LIMITED_log_##way, LIMITED_##way##_air, LIMITED_##way##_hot, \
    LIMITED_##way##_speed, LIMITED_##way##_other, LIMITED_##way##_speed_speed, \
    LIMITED_##way##_speed_other, LIMITED_##way##_other_other

static const int tau_of[] = {
    LIMITED_log_tau, LIMITED_air, LIMITED_hot, LIMITED_speed, LIMITED_target, LIMITED_speed_speed,
    LIMITED_speed_target, LIMITED_target_target
};
static const int rate_up[] = {COLUMNS(up)}, rate_down[] = {COLUMNS(down)};

static double free_tau(const double *p, const drive *at, double v, double w)
{
    return exp(clip(quadratic(p, tau_of, at, v, w), -2.5, 3.0));
}

/* Time constant of a spool at v that approaches w, so that |dv/dt| < r; u is the other spool's. */
static double limited_tau(const double *p, const drive *at, double v, double w, double u)
{
    double tau0 = free_tau(p, at, v, w);
    double log_r = quadratic(p, w > v ? rate_up : rate_down, at, v, u);
    double x = (w - v) / (tau0 * exp(clip(log_r, -5.0, 20.0)));
    return tau0 * sqrt(1.0 + x * x);
}

/* Advance output o; `pull` is that of the core. */
static void limited_output(const lags *q, const drive *at, double *x, int o, double step,
    double tau, double pull)
{
    const double *p = q->theta + LIMITED_SIZE * o, h = q->dt_s;
    double *soak = x + SOAK * NARXCAL_OUTPUTS + o, *casing = x + CASING * NARXCAL_OUTPUTS + o;
    double was = bounded(x[TARGET_WAS * NARXCAL_OUTPUTS + q->own[o]]);
    double w = bounded(at->target[q->own[o]]);
    double log_tau = OF(log_slow_tau) - OF(heat_rate) * w + OF(heat_air) * at->thin;
    double left = exp(OF(heat_speed) * (w - was)) * *soak;
    double taken = exp(OF(heat_speed) * w) * OF(slow_share) * step;
    double soak_now = soaked(left, taken, clip(log_tau, 0.0, 4.0), h);
    log_tau = clip(OF(log_casing_tau), 2.0, 5.0);
    double casing_now = soaked(*casing, OF(casing_share) * step, log_tau, h);
    pull -= (OF(lead_s) * step + OF(heat) * tau * (soak_now - *soak)) / h;
    x[o] = follow(x[o], pull, step, tau, h);
    finish(q, x, o, soak_now, casing_now);
}

static double speed_of(const double *x, const drive *at, int o)
{
    return bounded(x[TARGET_WAS * NARXCAL_OUTPUTS + o] - x[o] * at->per_unit[o]);
}

static void limited_step(const void *numbers, const sample *now, double *x, double *d)
{
    const lags *q = numbers;
    const drive at = drive_of(q, now);
    const int core = q->order[0], second = q->order[NARXCAL_OUTPUTS > 1];
    const int fan = q->own[second] == second ? second : core;
    const double *ss_was = x + SS_WAS * NARXCAL_OUTPUTS;
    double v = speed_of(x, &at, core), u = speed_of(x, &at, fan), w = bounded(at.target[core]);
    double before = lags_deviation(x, core), step = now->ss[core] - ss_was[core];
    double tau = limited_tau(q->theta + LIMITED_SIZE * core, &at, v, w, u);
    limited_output(q, &at, x, core, step, tau, 0.0);
    double d_core = lags_deviation(x, core), rate = (step - d_core + before) / q->dt_s;
    for (int j = 1; j < NARXCAL_OUTPUTS; j++) {
        const int o = q->order[j];
        const double *p = q->theta + LIMITED_SIZE * o;
        double strength = exp(clip(OF(rate_air) * at.thin + OF(rate_speed) * v, -3.0, 3.0));
        double pull = (OF(core) + OF(core_speed) * (v + w)) * d_core + OF(rate) * strength * rate;
        if (q->own[o] == o) tau = limited_tau(p, &at, speed_of(x, &at, o), bounded(at.target[o]), v);
        else tau = free_tau(p, &at, v, w);
        limited_output(q, &at, x, o, now->ss[o] - ss_was[o], tau, pull);
    }
    for (int o = 0; o < NARXCAL_OUTPUTS; o++) d[o] = lags_deviation(x, o);
    lags_note(&at, now, x);
}
