/* ---- responses of first and second order per output, their parameters over conditions */

typedef struct {
    int level;         /* whether the output's own steady value is the first condition */
    int conditions;    /* how many inputs are further ones */
    const int *columns;
    const grid *schedules; /* by output: ln tau, or ln xi and ln omega */
    double dt_s;
} response;

/* The state is by output: steady value, output, its rate, logarithms of its parameters. */
enum { RESPONSE_ROWS = 5 };

static void response_note(const response *p, const sample *now, int o, double *x)
{
    double at[MOST_AXES];
    int k = 0;
    if (p->level) at[k++] = now->ss[o];
    for (int c = 0; c < p->conditions; c++) at[k++] = now->in[p->columns[c]];
    x[0] = now->ss[o];
    x[3] = x[4] = 0.0;
    add_grid(&p->schedules[o], at, x + 3);
}

static void response_start(const void *numbers, const sample *now, const double *d, double *x)
{
    for (int o = 0; o < NARXCAL_OUTPUTS; o++, x += RESPONSE_ROWS) {
        response_note(numbers, now, o, x);
        x[1] = now->ss[o] - d[o];
        x[2] = 0.0;
    }
}

static void second_order(double u, double xi, double w, double h, double *x)
{
    double decay = xi * w, fall = exp(-decay * h), even, odd;
    double square = w * w * (xi * xi - 1.0) * h * h, root = sqrt(fabs(square));
    if (fabs(square) < 1e-8) even = 1.0 + square / 2.0, odd = h * (1.0 + square / 6.0);
    else if (square > 0.0) even = cosh(root), odd = h * sinh(root) / root;
    else even = cos(root), odd = h * sin(root) / root;
    even *= fall;
    odd *= fall;
    double rate = (u - x[0]) / h, behind = 2.0 * xi / w * rate; /* of a ramp that lasts */
    double e = x[1] - x[0] + behind, r = x[2] - rate;
    x[1] = u - behind + (even + decay * odd) * e + odd * r;
    x[2] = rate - w * w * odd * e + (even - decay * odd) * r;
}

static void response_step(const void *numbers, const sample *now, double *x, double *d)
{
    const response *p = numbers;
    for (int o = 0; o < NARXCAL_OUTPUTS; o++, x += RESPONSE_ROWS) {
        if (p->schedules[o].width == 1) x[1] = lag_step(x[1], x[0], now->ss[o], exp(x[3]) / p->dt_s);
        else second_order(now->ss[o], exp(x[3]), exp(x[4]), p->dt_s, x);
        d[o] = now->ss[o] - x[1];
        response_note(p, now, o, x);
    }
}
