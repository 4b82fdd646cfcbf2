/* ---- state space: d = C x - added, x+ = A x + B (ss+ - ss); what a start adds fades */

typedef struct {
    int order;
    const double *A, *B, *C;
    double fade;
} state_space;

/* The state is x, what is added, and the steady values of the newest sample. */
static void state_space_start(const void *numbers, const sample *now, const double *d, double *x)
{
    const state_space *p = numbers;
    double *added = x + p->order, *ss = added + NARXCAL_OUTPUTS;
    for (int i = 0; i < p->order; i++) x[i] = 0.0;
    for (int o = 0; o < NARXCAL_OUTPUTS; o++) added[o] = -d[o], ss[o] = now->ss[o];
}

static void state_space_step(const void *numbers, const sample *now, double *x, double *d)
{
    const state_space *p = numbers;
    const int n = p->order;
    double *added = x + n, *ss = added + NARXCAL_OUTPUTS, next[STATE_SPACE_ORDER];
    for (int i = 0; i < n; i++) {
        next[i] = 0.0;
        for (int j = 0; j < n; j++) next[i] += p->A[i * n + j] * x[j];
        for (int o = 0; o < NARXCAL_OUTPUTS; o++)
            next[i] += p->B[i * NARXCAL_OUTPUTS + o] * (now->ss[o] - ss[o]);
    }
    for (int i = 0; i < n; i++) x[i] = next[i];
    for (int o = 0; o < NARXCAL_OUTPUTS; o++) {
        added[o] *= p->fade;
        ss[o] = now->ss[o];
        d[o] = -added[o];
        for (int i = 0; i < n; i++) d[o] += p->C[o * n + i] * x[i];
    }
}
