/* ---- a first-order lag behind a straight line from `before` to `after`, one sample later;
 * its time constant is `samples` long */
static double lag_step(double y, double before, double after, double samples)
{
    double behind = samples * (after - before);
    return after - behind + (y - before + behind) * exp(-1.0 / samples);
}
