/* ---- lags: a lumped two-spool engine between the steady state and the network
 * dd/dt = dss/dt - (d - pull) / tau, in closed form over a step. */

/* Rows of the state, each of all outputs. The first three add up to the deviation; the next five
 * are the core's under a governor, as deviations from its steady value; the last two are of the
 * newest sample: corrected and scaled steady values, steady values. */
enum { FAST, SOAK, CASING, FUEL_WAS, RESET, METAL, COVER, FAN_RATE, TARGET_WAS, SS_WAS, LAG_ROWS };

typedef struct {
    const int *air;
    const double *theta, *centre, *half, *limit;
    const int *order;  /* outputs: the core, the fan, the others */
    const int *own;    /* the speed on which each output depends */
    const int *rank;   /* place of each output in `order` */
    const int *slow;   /* whether what an output deviates by at the start is heat */
    double dt_s;
} lags;

/* What the engine follows: the steady state of a sample, corrected and scaled, and the air. */
typedef struct {
    double target[NARXCAL_OUTPUTS], per_unit[NARXCAL_OUTPUTS];
    double thin, hot, mach;
} drive;

static drive drive_of(const lags *p, const sample *now)
{
    const air at = air_at(p->air, now->in);
    const double root = sqrt(at.theta2);
    drive found;
    found.thin = log(root / at.delta2);
    found.hot = log(root);
    found.mach = channel_of(now->in, p->air[1]);
    for (int o = 0; o < NARXCAL_OUTPUTS; o++) {
        found.target[o] = (now->ss[o] / root - p->centre[o]) / p->half[o];
        found.per_unit[o] = 1.0 / (root * p->half[o]);
    }
    return found;
}

static void lags_note(const drive *at, const sample *now, double *x)
{
    for (int o = 0; o < NARXCAL_OUTPUTS; o++) {
        x[TARGET_WAS * NARXCAL_OUTPUTS + o] = at->target[o];
        x[SS_WAS * NARXCAL_OUTPUTS + o] = now->ss[o];
    }
}

static void lags_start(const void *numbers, const sample *now, const double *d, double *x)
{
    const lags *p = numbers;
    const drive at = drive_of(p, now);
    for (int i = 0; i < LAG_ROWS * NARXCAL_OUTPUTS; i++) x[i] = 0.0;
    for (int o = 0; o < NARXCAL_OUTPUTS; o++)
        x[(p->slow[o] ? CASING : FAST) * NARXCAL_OUTPUTS + o] = d[o];
    lags_note(&at, now, x);
}

static double lags_deviation(const double *x, int o)
{
    return x[o] + x[SOAK * NARXCAL_OUTPUTS + o] + x[CASING * NARXCAL_OUTPUTS + o];
}

/* p . [1, thin, hot, x, y, x^2, x y, y^2]; c has the places of the coefficients. */
static double quadratic(const double *p, const int *c, const drive *at, double x, double y)
{
    double level = p[c[0]] + p[c[1]] * at->thin + p[c[2]] * at->hot;
    double by_x = p[c[3]] + p[c[5]] * x + p[c[6]] * y;
    return level + by_x * x + (p[c[4]] + p[c[7]] * y) * y;
}

/* A scaled speed as polynomials take it. */
static double bounded(double speed)
{
    return clip(speed, -1.5, 1.5);
}

/* Deviation after a step h in which ss moves by `step`. */
static double follow(double d, double pull, double step, double tau, double h)
{
    double a = exp(-h / tau);
    return a * d + (1.0 - a) * (pull + step * tau / h);
}

/* Heat after a step, from that before it and its share of the move. */
static double soaked(double soak, double increment, double log_tau, double h)
{
    return exp(-h / exp(log_tau)) * (soak + increment);
}

/* Store the slow parts, and the fast one so that the sum stays within the limit. */
static void finish(const lags *p, double *x, int o, double soak, double casing)
{
    double slow = soak + casing;
    x[o] = clip(x[o] + slow, -p->limit[o], p->limit[o]) - slow;
    x[SOAK * NARXCAL_OUTPUTS + o] = soak;
    x[CASING * NARXCAL_OUTPUTS + o] = casing;
}
