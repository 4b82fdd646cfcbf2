/* ---- output error: N_H, N_L and T behind their steady values (narxcal/output_error) */

typedef struct {
    int driver;
    double low, high;    /* range of the driver over which slopes are taken */
    const int *order;    /* columns of N_H, N_L, T */
    double tau_H, tau_L, tau_T, tau_M; /* in samples */
    double rate_H, rate_L, alpha, beta, reference;
} output_error;

/* Steady N_H, N_L, T, and the slopes dN_L/dN_H and dT/dN_H along the driver. */
static void engine_drive(const output_error *p, const sample *now, double *u)
{
    const double step = 0.01 * (p->high - p->low);
    double in[NARXCAL_INPUTS], more[NARXCAL_OUTPUTS], less[NARXCAL_OUTPUTS];
    for (int i = 0; i < NARXCAL_INPUTS; i++) in[i] = now->in[i];
    in[p->driver] = clip(now->in[p->driver] + step, p->low, p->high);
    steady(now->engine, in, more);
    in[p->driver] = clip(now->in[p->driver] - step, p->low, p->high);
    steady(now->engine, in, less);
    double rise = more[p->order[0]] - less[p->order[0]];
    for (int k = 0; k < 3; k++) u[k] = now->ss[p->order[k]];
    for (int k = 1; k < 3; k++)
        u[2 + k] = fabs(rise) > 1e-6 ? (more[p->order[k]] - less[p->order[k]]) / rise : 0.0;
}

/* The state is N_H, N_L, T and what drove them at the newest sample. */
static void output_error_start(const void *numbers, const sample *now, const double *d, double *x)
{
    const output_error *p = numbers;
    engine_drive(p, now, x + 3);
    for (int k = 0; k < 3; k++) x[k] = now->ss[p->order[k]] - d[p->order[k]];
}

static void output_error_step(const void *numbers, const sample *now, double *x, double *d)
{
    const output_error *p = numbers;
    double u[5], was[3], goal[3], *drive_was = x + 3;
    engine_drive(p, now, u);
    for (int k = 0; k < 3; k++) { /* the lag of the fuel meter is undone on the line */
        double ahead = p->tau_M * (u[k] - drive_was[k]);
        was[k] = drive_was[k] + ahead;
        goal[k] = u[k] + ahead;
    }
    double behind = x[0] - was[0], above = x[0] - p->reference;
    x[0] = lag_step(x[0], was[0], goal[0], p->tau_H * exp(-p->rate_H * above));
    double left = x[0] - goal[0];
    for (int k = 1; k < 3; k++) {
        double by = 1.0 - (k == 1 ? p->alpha : p->beta);
        double samples = k == 1 ? p->tau_L * exp(-p->rate_L * above) : p->tau_T;
        double before = was[k] + by * drive_was[2 + k] * behind, after = goal[k] + by * u[2 + k] * left;
        x[k] = lag_step(x[k], before, after, samples);
    }
    for (int o = 0; o < NARXCAL_OUTPUTS; o++) d[o] = 0.0; /* other outputs are steady */
    for (int k = 0; k < 3; k++) d[p->order[k]] = now->ss[p->order[k]] - x[k];
    for (int k = 0; k < 5; k++) drive_was[k] = u[k];
}
