/* ---- member: a simple model of one output: first-order lag, or ARX of an order */

typedef struct {
    int channel, order;
    double push, pull;            /* gains of a lag (order 0) per sample, up and down */
    const double *poles, *gains;  /* (order,) and (order + 1, outputs) */
    double offset;
} member;

/* The state is past outputs, then past steady states, newest first. */
static void member_start(const void *numbers, const sample *now, const double *d, double *x)
{
    const member *p = numbers;
    const int order = p->order > 0 ? p->order : 1;
    for (int k = 0; k < order; k++) {
        x[k] = now->ss[p->channel] - d[p->channel];
        for (int o = 0; o < NARXCAL_OUTPUTS; o++) x[order + k * NARXCAL_OUTPUTS + o] = now->ss[o];
    }
}

static void member_step(const void *numbers, const sample *now, double *x, double *d)
{
    const member *p = numbers;
    const int n = NARXCAL_OUTPUTS, order = p->order;
    double y = p->offset, ahead = now->ss[p->channel] - x[0];
    for (int o = 0; o < n; o++) d[o] = 0.0;
    if (order == 0) y = x[0] + (ahead > 0.0 ? p->push : p->pull) * ahead;
    for (int i = 0; order > 0 && i <= order; i++) {
        const double *ss = i ? x + order + (i - 1) * n : now->ss;
        for (int o = 0; o < n; o++) y += p->gains[i * n + o] * ss[o];
        if (i) y += p->poles[i - 1] * x[i - 1];
    }
    for (int k = order - 1; k > 0; k--) {
        x[k] = x[k - 1];
        for (int o = 0; o < n; o++) x[order + k * n + o] = x[order + (k - 1) * n + o];
    }
    for (int o = 0; order > 0 && o < n; o++) x[order + o] = now->ss[o];
    x[0] = y;
    d[p->channel] = now->ss[p->channel] - y;
}
