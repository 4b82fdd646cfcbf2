/* ---- lags under a governor of the fan's speed: fuel accelerates the core until N1 is met */

/* State of core, fan and control: v, u, f, r, du/dt, m, n of narxcal/lumped. */
typedef struct {
    double core, fan, fuel, reset, fan_rate, metal, casing;
} spools;

/* A time, gain or limit exp(q . [z(v, u), Mach]), bounded at e^5. */
static double line(const double *q, const drive *at, double v, double u)
{
    static const int places[] = {0, 1, 2, 4, 5, 6, 7, 8};
    return exp(clip(quadratic(q, places, at, v, u) + q[REGRESSOR_Mach] * at->mach, -5.0, 5.0));
}

#define LINE(name) (q->theta + LINE_##name * REGRESSORS)

/* Mean slope of an output over the core's speed between v and w. */
static double chord(const double *p, const drive *at, double v, double w)
{
    double flat = p[0] + p[1] * at->thin + p[2] * at->mach, tilt = p[3] + p[4] * at->mach;
    return flat + tilt * (v + w) + p[5] * (v * v + v * w + w * w);
}

static double opening(double metal, double casing)
{
    return fmax(metal - casing, 0.0);
}

/* Advance control, valve, spools and metal by backward Euler to the steady states w of the core and
 * s of the fan. With a = dv/dt all of the end of the step is linear in a, and so is the governor's
 * equation: it gives a, which the schedules limit. c is the chord of the fan. */
static void spools_step(const lags *q, const drive *at, spools *r, double w, double s, double c,
    double h)
{
    const double v = bounded(r->core), u = bounded(r->fan), valve = clip(q->theta[EXTRA], 0.01, 1.0);
    const double core = line(LINE(core_s), at, v, u), fan = line(LINE(fan_s), at, v, u);
    const double gain = line(LINE(gain), at, v, u), lead = valve + line(LINE(lead_s), at, v, u);
    const double reset = h / (fan * core / (fan + core) + line(LINE(reset_s), at, v, u)), k = h / fan;
    const double u_0 = (r->fan + k * (s - c * (w - r->core))) / (1.0 + k);
    const double u_1 = k * (c * h + line(LINE(push), at, v, u)) / (1.0 + k);
    /* (f_d - v') / core = m a + b */
    const double m = 1.0 + valve * (h + core) / (h * core);
    const double b = valve * (r->core - r->fuel) / (h * core), gained = gain * (1.0 + reset);
    const double error = s - u_0 - lead * (u_0 - r->fan) / h;
    double a = (gained * error - r->core - core * b + r->reset)
        / (h + core * m + gained * u_1 * (1.0 + lead / h));
    double cost = exp(clip(q->theta[EXTRA + 1] * opening(r->metal, r->casing), -1.0, 1.0));
    double metal_s = exp(clip(2.85 - 0.5 * v + 0.8 * at->thin, -5.0, 5.0));
    a = fmin(a, (line(LINE(up), at, v, u) / cost - b) / m);
    a = fmax(a, (-line(LINE(down), at, v, u) * cost - b) / m);
    r->core += h * a;
    r->fuel = r->core + core * a;
    r->reset = (r->reset + reset * (r->core + core * (m * a + b))) / (1.0 + reset);
    r->fan_rate = (u_0 + u_1 * a - r->fan) / h;
    r->fan = u_0 + u_1 * a;
    r->metal = r->fuel + (r->metal - r->fuel) * exp(-h / metal_s);
    r->casing = r->metal + (r->casing - r->metal) * exp(-h / 80.0);
}

/* Advance soak and casing of all outputs; was_open is how far clearances were open. */
static void governed_heat(const lags *q, const drive *at, const sample *now, double *x,
    double was_open)
{
    const int n = NARXCAL_OUTPUTS, core = q->order[0];
    double w = bounded(at->target[core]);
    double is_open = opening(x[COVER * n + core], x[METAL * n + core]); /* deviations */
    for (int j = 0; j < n; j++) {
        const int o = q->order[j];
        const double *p = q->theta + HEATS + HEAT_TERMS * j;
        double step = now->ss[o] - x[SS_WAS * n + o], share = p[4] / at->per_unit[o];
        double log_tau = clip(p[1] + p[2] * w + p[3] * at->thin, -0.5, 4.5);
        double soak = soaked(x[SOAK * n + o], p[0] * step, log_tau, q->dt_s);
        log_tau = clip(p[5], 2.0, 5.0);
        double left = soaked(x[CASING * n + o], -share * was_open, log_tau, q->dt_s);
        finish(q, x, o, soak, left + share * is_open);
    }
}

static void governed_step(const void *numbers, const sample *now, double *x, double *d)
{
    const lags *q = numbers;
    const drive at = drive_of(q, now);
    const int n = NARXCAL_OUTPUTS, core = q->order[0], fan = q->order[1];
    const int count = (int)fmax(1.0, ceil(q->dt_s / 0.04 - 1e-9)); /* inner steps */
    const double h = q->dt_s / count, *start = x + TARGET_WAS * n, *end = at.target;
    const double w_step = (end[core] - start[core]) / count;
    const double s_step = (end[fan] - start[fan]) / count, w_end = end[core];
    double w = start[core], s = start[fan];
    double was_open = opening(x[COVER * n + core], x[METAL * n + core]);
    spools r = {w - x[core] * at.per_unit[core], s - x[fan] * at.per_unit[fan],
        w - x[FUEL_WAS * n + core], w - x[RESET * n + core], x[FAN_RATE * n + core],
        w - x[METAL * n + core], w - x[COVER * n + core]};
    for (int i = 0; i < count; i++) {
        const spools was = r;
        double w_was = w, s_was = s, v = bounded(r.core), u = bounded(r.fan);
        w = start[core] + (i + 1) * w_step;
        s = start[fan] + (i + 1) * s_step;
        double settled = bounded(w), c = fmax(chord(q->theta + SLOPES, &at, v, settled), 0.05);
        spools_step(q, &at, &r, w, s, c, h);
        double power = (r.core - was.core) / h, d_core = 0.5 * (w_was - was.core + w - r.core);
        double beside = s_was - was.fan - c * d_core;
        for (int j = 2; j < n; j++) {
            const int o = q->order[j];
            const double *lines = q->theta + REGRESSORS * (LINE_SIZE + 2 * (j - 2));
            double step = (now->ss[o] - x[SS_WAS * n + o]) / count;
            c = chord(q->theta + SLOPES + SLOPE_TERMS * (j - 1), &at, v, settled);
            double pull = c * d_core - line(lines + REGRESSORS, &at, v, u) * power;
            pull = (pull + q->theta[EXTRA + j] * beside) / at.per_unit[o];
            x[o] = follow(x[o], pull, step, line(lines, &at, v, u), h);
        }
    }
    x[core] = (w_end - r.core) / at.per_unit[core];
    x[fan] = (end[fan] - r.fan) / at.per_unit[fan];
    x[FUEL_WAS * n + core] = clip(w_end - r.fuel, -5.0, 5.0);
    x[RESET * n + core] = clip(w_end - r.reset, -5.0, 5.0);
    x[METAL * n + core] = clip(w_end - r.metal, -5.0, 5.0);
    x[COVER * n + core] = clip(w_end - r.casing, -5.0, 5.0);
    x[FAN_RATE * n + core] = clip(r.fan_rate, -20.0, 20.0);
    governed_heat(q, &at, now, x, was_open);
    for (int o = 0; o < n; o++) d[o] = lags_deviation(x, o);
    lags_note(&at, now, x);
}
