/* ---- grid: multilinear interpolation between nodes, held beyond the outermost ones */

typedef struct {
    int dims, width;            /* axes; numbers at each node */
    const int *columns;         /* the input that each axis stands for */
    const int *lengths;         /* nodes of each axis */
    const double *nodes;        /* the axes one after the other, each rising */
    const double *values;       /* the last axis varies fastest */
    const unsigned char *known; /* whether the model holds at each node, NULL for everywhere */
} grid;

/* Add the values at `in` to `out`; returns 0 if they rest on a node that is not known. */
static int add_grid(const grid *g, const double *in, double *out)
{
    double share[MOST_AXES];
    size_t stride[MOST_AXES], base = 0, step = 1, nodes = 0;
    int active = 0, known = 1;
    for (int d = 0; d < g->dims; d++) nodes += (size_t)g->lengths[d];
    for (int d = g->dims - 1; d >= 0; d--) {
        size_t count = (size_t)g->lengths[d];
        const double *axis = g->nodes + (nodes -= count);
        double x = clip(in[g->columns[d]], axis[0], axis[count - 1]);
        size_t low = cell(axis, count, x);
        if (x >= axis[count - 1]) low = count - 1;
        base += low * step;
        if (x > axis[low]) { /* on a node, the axis needs no neighbour */
            share[active] = (x - axis[low]) / (axis[low + 1] - axis[low]);
            stride[active++] = step;
        }
        step *= count;
    }
    for (unsigned int corner = 0; corner < 1u << active; corner++) {
        double weight = 1.0;
        size_t row = base;
        for (int d = 0; d < active; d++) {
            weight *= corner >> d & 1u ? share[d] : 1.0 - share[d];
            row += corner >> d & 1u ? stride[d] : 0;
        }
        if (g->known && !g->known[row]) known = 0;
        for (int o = 0; o < g->width; o++) out[o] += weight * g->values[row * g->width + o];
    }
    return known;
}
