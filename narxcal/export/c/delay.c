/* ---- transport delay: u_d(k) = (1 - f) u(k - n) + f u(k - n - 1); constant before the start */

/* The state is DELAY_ROWS = n + 1 rows of the inputs that act late, the oldest first. */
static void delay_start(const double *in, double *past)
{
    for (int row = 0; row < DELAY_ROWS; row++)
        for (int c = 0; c < DELAY_COLUMNS; c++) *past++ = in[delay_column[c]];
}

static void delay_step(double *in, double *past)
{
    for (int c = 0; c < DELAY_COLUMNS; c++) {
        const double newest = in[delay_column[c]], before = past[c];
        for (int row = 1; row < DELAY_ROWS; row++)
            past[(row - 1) * DELAY_COLUMNS + c] = past[row * DELAY_COLUMNS + c];
        past[(DELAY_ROWS - 1) * DELAY_COLUMNS + c] = newest;
        in[delay_column[c]] = (1.0 - DELAY_PART) * past[c] + DELAY_PART * before;
    }
}
