/* ---- steady state fitted to flights: curves over a driver in corrected parameters */

enum { PLAIN, SPEED, TEMPERATURE, FUEL, THRUST };

typedef struct {
    const int *air;            /* columns of altitude, Mach and temperature deviation */
    const int *kinds;          /* of the outputs, PLAIN where they are not corrected */
    int driver, fuel;          /* its column; FUEL: log of corrected flow, PLAIN: log, -1: lever */
    const double *low, *high;  /* ends of the envelope */
    const double *seen;        /* range of the driver in the fit */
    int knots;
    const double *knot;
    const double *curve;       /* [engine][piece][output][corner][3]: value, slope, curvature */
    int blends, switches, ratios;
    const int *blend;          /* columns between whose extremes curves are blended */
    const int *switch_column;
    const double *switch_line; /* [switch][output][2] */
    const int *ratio;          /* 0: theta2, 1: delta2 */
    const double *ratio_seen;  /* [ratio][2]: range of its logarithm in the fit */
    const double *ratio_line;  /* [ratio][output][2] */
} fitted;

static double corrected_scale(int kind, const air *at)
{
    if (kind == SPEED) return sqrt(at->theta2);
    if (kind == TEMPERATURE) return at->theta2;
    if (kind == FUEL) return at->delta2 * sqrt(at->theta2);
    return kind == THRUST ? at->delta2 : 1.0;
}

/* Weights of the corners of the envelope in the blending channels; the last varies fastest. */
static void corner_weights(const fitted *p, const double *in, double *weights)
{
    weights[0] = 1.0;
    for (int b = 0; b < p->blends; b++) {
        double low = p->low[p->blend[b]], width = fmax(p->high[p->blend[b]] - low, 1e-12);
        double x = clip((in[p->blend[b]] - low) / width, 0.0, 1.0);
        for (int c = (1 << b) - 1; c >= 0; c--) {
            weights[2 * c + 1] = weights[c] * x;
            weights[2 * c] = weights[c] * (1.0 - x);
        }
    }
}

static int fitted_outputs(const fitted *p, int engine, const double *in, double *ss)
{
    const air at = air_at(p->air, in);
    double z = in[p->driver], weights[FITTED_CORNERS];
    int inside = 1;
    if (p->fuel >= 0) z = log(fmax(z / corrected_scale(p->fuel, &at), 1.0));
    for (int i = 0; i < NARXCAL_INPUTS; i++)
        if (in[i] < p->low[i] || in[i] > p->high[i]) inside = 0;
    if (z < p->seen[0] || z > p->seen[1]) inside = 0;
    z = clip(z, p->knot[0], p->knot[p->knots - 1]);
    size_t piece = cell(p->knot, p->knots, z), row = engine * (p->knots - 1) + piece;
    double s = z - p->knot[piece];
    double x = (z - p->knot[0]) / (p->knot[p->knots - 1] - p->knot[0]) - 0.5;
    corner_weights(p, in, weights);
    for (size_t o = 0; o < NARXCAL_OUTPUTS; o++) {
        const double *line, *c = p->curve + 3 * FITTED_CORNERS * (row * NARXCAL_OUTPUTS + o);
        double y = 0.0;
        for (int v = 0; v < FITTED_CORNERS; v++, c += 3)
            y += weights[v] * (c[0] + (c[1] + c[2] * s) * s);
        for (int k = 0; k < p->switches; k++) {
            line = p->switch_line + 2 * (k * NARXCAL_OUTPUTS + o);
            y += in[p->switch_column[k]] * (line[0] + line[1] * x);
        }
        for (int k = 0; k < p->ratios; k++) {
            const double *seen = p->ratio_seen + 2 * k;
            double ratio = log(p->ratio[k] ? at.delta2 : at.theta2);
            line = p->ratio_line + 2 * (k * NARXCAL_OUTPUTS + o);
            ratio = clip(ratio, seen[0], seen[1]) - 0.5 * (seen[0] + seen[1]);
            y += ratio * (line[0] + line[1] * x);
        }
        ss[o] = y * corrected_scale(p->kinds[o], &at);
        if (p->kinds[o] == TEMPERATURE) ss[o] -= KELVIN;
    }
    return inside;
}
