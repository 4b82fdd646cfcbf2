/* ---- narx: the network, on its own past deviations, increments of the steady state, the steady
 * state and the flight condition, with or without lags in front of it */

typedef struct {
    int hidden, lags, taps, depth, width; /* depth: longest tap; width: features */
    int moving;             /* features that vanish in equilibrium; > 0: the network is anchored */
    int schedules;
    const int *tap, *schedule;
    const double *in_centre, *in_scale, *out_centre, *out_scale; /* scaled = (value - centre) / scale */
    const double *w1, *b1, *w2, *b2, *a, *low, *high;
    double keep;            /* pole of the fading bound, negative without it */
    const double *share;    /* of the network's deviation, by output */
    start_function *lag_start; /* lags in front, NULL for none */
    step_function *lag_step;
    const void *lag;
} narx;

/* Places in the state: steady values, error and envelope of the fading bound, deviations (newest
 * first), rows of features (newest last), the state of the lags. */
enum { NARX_SS, NARX_ERROR = NARXCAL_OUTPUTS, NARX_BOUND = 2 * NARXCAL_OUTPUTS,
    NARX_HISTORY = 3 * NARXCAL_OUTPUTS };

static double *narx_rows(const narx *p, double *x)
{
    return x + NARX_HISTORY + p->lags * NARXCAL_OUTPUTS;
}

static void features(const narx *p, const sample *now, const double *was, const double *lagged,
    double *row)
{
    int i = 0;
    for (int o = 0; o < NARXCAL_OUTPUTS; o++) row[i++] = now->ss[o] - was[o];
    for (int o = 0; p->lag && o < NARXCAL_OUTPUTS; o++) row[i++] = lagged[o];
    for (int o = 0; o < NARXCAL_OUTPUTS; o++) row[i++] = now->ss[o];
    for (int k = 0; k < p->schedules; k++) row[i++] = now->in[p->schedule[k]];
    for (i = 0; i < p->width; i++) row[i] = (row[i] - p->in_centre[i]) / p->in_scale[i];
}

static void narx_start(const void *numbers, const sample *now, const double *d, double *x)
{
    const narx *p = numbers;
    double *rows = narx_rows(p, x), nothing[NARXCAL_OUTPUTS] = {0.0};
    const double *own = p->lag ? nothing : d; /* what deviates at the start is the lags' own */
    for (int o = 0; o < NARXCAL_OUTPUTS; o++) {
        x[NARX_SS + o] = now->ss[o];
        x[NARX_ERROR + o] = 0.0;
        x[NARX_BOUND + o] = fabs(own[o]);
        for (int k = 0; k < p->lags; k++)
            x[NARX_HISTORY + k * NARXCAL_OUTPUTS + o] = (own[o] - p->out_centre[o]) / p->out_scale[o];
    }
    for (int k = 0; k <= p->depth; k++) features(p, now, now->ss, d, rows + k * p->width);
    if (p->lag) p->lag_start(p->lag, now, d, rows + (p->depth + 1) * p->width);
}

/* A phi of a row of weights: past deviations, then features from `first` on, by taps. */
static double weighted(const narx *p, const double *w, const double *history, const double *rows,
    int first, int last)
{
    double total = 0.0;
    const int m = p->lags * NARXCAL_OUTPUTS;
    for (int j = 0; history && j < m; j++) total += w[j] * history[j];
    for (int t = 0; t < p->taps; t++) {
        const double *row = rows + (p->depth - p->tap[t]) * p->width;
        for (int i = first; i < last; i++) total += w[m + t * p->width + i] * row[i];
    }
    return total;
}

/* Scaled outputs of the network before their bounds; an anchored one subtracts its value at rest. */
static void network(const narx *p, const double *history, const double *rows, double *v)
{
    const int phi = p->lags * NARXCAL_OUTPUTS + p->taps * p->width;
    const int anchored = p->moving > 0, shown = anchored ? p->moving : p->width;
    for (int o = 0; o < NARXCAL_OUTPUTS; o++) {
        v[o] = weighted(p, p->a + o * phi, history, rows, 0, shown);
        if (!anchored) v[o] += p->b2[o];
    }
    for (int u = 0; u < p->hidden; u++) {
        const double *w = p->w1 + u * phi;
        double rest = p->b1[u] + weighted(p, w, NULL, rows, shown, p->width);
        double t = tanh(rest + weighted(p, w, history, rows, 0, shown));
        if (anchored) t -= tanh(rest);
        for (int o = 0; o < NARXCAL_OUTPUTS; o++) v[o] += p->w2[o * p->hidden + u] * t;
    }
}

static void narx_step(const void *numbers, const sample *now, double *x, double *d)
{
    const narx *p = numbers;
    const int n = NARXCAL_OUTPUTS, m = p->lags * n, past = p->depth * p->width;
    double *rows = narx_rows(p, x), *history = x + NARX_HISTORY, v[NARXCAL_OUTPUTS];
    double lagged[NARXCAL_OUTPUTS] = {0.0};
    if (p->lag) p->lag_step(p->lag, now, rows + past + p->width, lagged);
    for (int i = 0; i < past; i++) rows[i] = rows[i + p->width];
    features(p, now, x + NARX_SS, lagged, rows + past);
    network(p, history, rows, v);
    for (int j = m - 1; j >= n; j--) history[j] = history[j - n];
    for (int o = 0; o < n; o++) {
        double y = v[o] > p->low[o] ? fmin(v[o], p->high[o]) : p->low[o];
        if (p->keep >= 0.0) { /* an EGT overshoots by up to 1.6 times the change: twice is allowed */
            double *error = x + NARX_ERROR + o, *bound = x + NARX_BOUND + o;
            *error = p->keep * (*error + now->ss[o] - x[NARX_SS + o]);
            *bound = fmax(fabs(*error), p->keep * *bound);
            double limit = 2.0 * *bound / p->out_scale[o];
            y = y > -limit ? fmin(y, limit) : -limit;
        }
        history[o] = y;
        d[o] = p->share[o] * (y * p->out_scale[o] + p->out_centre[o]) + lagged[o];
        x[NARX_SS + o] = now->ss[o];
    }
}
