/* What every part of the model uses. Equations and symbols: docs/theory.md of narxcal. */

#define MOST_AXES (NARXCAL_INPUTS + 1)

/* A sample: its inputs, within the limits of the model, and where the engine settles at them. */
typedef struct {
    double in[NARXCAL_INPUTS];
    double ss[NARXCAL_OUTPUTS];
    int engine;
} sample;

/* A part of the dynamic model gives its deviation d = ss - y, from numbers p and a state x. */
typedef void start_function(const void *p, const sample *now, const double *d, double *x);
typedef void step_function(const void *p, const sample *now, double *x, double *d);
typedef struct {
    start_function *start; /* state at constant inputs and the deviation d */
    step_function *step;   /* advance the state to the sample `now` */
    const void *p;
    const double *weights; /* of its deviation in the sum, by output */
    size_t at;             /* where its state begins in narxcal_state.x */
} part;

/* Steady state at the inputs; returns whether they are inside the envelope. */
static int steady(int engine, const double *in, double *ss);

static double clip(double x, double low, double high)
{
    return x < low ? low : x > high ? high : x;
}

/* The cell of rising nodes in which x lies: the last one that begins at or below x. */
static size_t cell(const double *nodes, size_t count, double x)
{
    size_t low = 0, high = count > 1 ? count - 1 : 1;
    while (high - low > 1) {
        size_t middle = (low + high) / 2;
        if (nodes[middle] <= x) low = middle;
        else high = middle;
    }
    return low;
}
