/* ---- air: standard atmosphere (ISO 2533) and total ratios at the intake, gamma = 1.4 */

#define KELVIN 273.15

typedef struct {
    double theta2, delta2; /* total temperature and pressure over those at sea level */
} air;

static double channel_of(const double *in, int column)
{
    return column < 0 ? 0.0 : in[column];
}

/* Air at columns of altitude [ft], Mach number and deviation of temperature [degC]; -1 is 0. */
static air air_at(const int *columns, const double *in)
{
    const double lapse = 0.0065, g = 9.80665, gas = 287.05287, t0 = 288.15, tropopause = 11e3;
    double height = fmin(channel_of(in, columns[0]) * 0.3048, 20e3);
    double standard = t0 - lapse * fmin(height, tropopause);
    double above = fmax(height - tropopause, 0.0), mach = channel_of(in, columns[1]);
    double pressure = pow(standard / t0, g / (gas * lapse));
    double rise = 1.0 + 0.2 * mach * mach;
    if (above > 0.0) pressure *= exp(-g * above / (gas * (t0 - lapse * tropopause)));
    air found = {(standard + channel_of(in, columns[2])) / t0 * rise, 0.0};
    found.delta2 = pressure * (rise * rise * rise * sqrt(rise));
    return found;
}
