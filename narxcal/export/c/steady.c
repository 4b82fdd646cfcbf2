/* Sum of multilinear interpolations, each on a grid of its own, held at the grid's border. */
#include <math.h>
#include <stddef.h>

#include "steady.h"

typedef struct {
    int dims;
    const int *columns;    /* the inputs that its axes stand for */
    const size_t *lengths; /* nodes of each axis */
    size_t n_nodes;
    const double *nodes;        /* the axes one after the other, each rising */
    const double *values;       /* N_OUT numbers a row, the last axis varying fastest */
    const unsigned char *known; /* whether the model holds at each row, NULL for everywhere */
} Block;

#include "table.h"

/* Adds the block's values at `in` to `out`; returns 0 if they rest on a node that is not known. */
static int add(const Block *block, const double *in, double *out)
{
    double share[N_IN];
    size_t stride[N_IN], base = 0, step = 1;
    int active = 0, known = 1;
    const double *axis = block->nodes + block->n_nodes;
    for (int d = block->dims - 1; d >= 0; d--) {
        size_t low = 0, high = block->lengths[d] - 1;
        axis -= block->lengths[d];
        double x = fmin(fmax(in[block->columns[d]], axis[low]), axis[high]);
        while (high - low > 1) {
            size_t middle = (low + high) / 2;
            if (axis[middle] <= x) low = middle;
            else high = middle;
        }
        base += (x == axis[high] ? high : low) * step;
        if (x > axis[low] && x < axis[high]) { /* on a node, the axis needs no neighbour */
            share[active] = (x - axis[low]) / (axis[high] - axis[low]);
            stride[active++] = step;
        }
        step *= block->lengths[d];
    }
    for (unsigned int corner = 0; corner < 1u << active; corner++) {
        double weight = 1.0;
        size_t row = base;
        for (int d = 0; d < active; d++) {
            weight *= corner >> d & 1u ? share[d] : 1.0 - share[d];
            row += corner >> d & 1u ? stride[d] : 0;
        }
        if (block->known && !block->known[row]) known = 0;
        for (int o = 0; o < N_OUT; o++) out[o] += weight * block->values[row * N_OUT + o];
    }
    return known;
}

static void evaluate(Steady *model)
{
    const double *in = model->values;
    double *out = model->values + N_IN, *inside = out + N_OUT;
    int finite = 1;
    *inside = 1.0;
    for (int i = 0; i < N_IN; i++) {
        if (!isfinite(in[i])) finite = 0;
        if (!(in[i] >= low_ends[i] && in[i] <= high_ends[i])) *inside = 0.0;
    }
    for (int o = 0; o < N_OUT; o++) out[o] = finite ? 0.0 : NAN;
    for (int b = 0; finite && b < N_BLOCKS; b++)
        if (!add(&blocks[b], in, out)) *inside = 0.0;
    model->changed = 0;
}

void steady_restart(Steady *model)
{
    for (int i = 0; i < N_IN; i++) model->values[i] = start_values[i];
    model->changed = 1;
}

int steady_set(Steady *model, const unsigned int *references, size_t count, const double *values)
{
    for (size_t k = 0; k < count; k++)
        if (references[k] >= N_IN) return 1;
    for (size_t k = 0; k < count; k++) model->values[references[k]] = values[k];
    model->changed = 1;
    return 0;
}

int steady_get(Steady *model, const unsigned int *references, size_t count, double *values)
{
    for (size_t k = 0; k < count; k++)
        if (references[k] >= N_VARIABLES) return 1;
    if (model->changed) evaluate(model);
    for (size_t k = 0; k < count; k++) values[k] = model->values[references[k]];
    return 0;
}
