"""A free-turbine turboprop as a recorder writes it: propeller speed, torque in ft-lb, power in shp.

The gas generator follows the power lever with a lag, the power turbine gives what its speed allows
in corrected parameters, and a governor holds the propeller where there is power for it.
"""

from pathlib import Path

import numpy as np
import pandas as pd

from narxcal.atmosphere import air_state
from narxcal.support.arrays import FloatArray

RATE_HZ = 8
LBF_FT_NM, HP_KW = 1.3558179483314004, 0.7456998715822702
GOVERNED_RPM, FULL_KW, LEAST_KW = 1700.0, 1100.0, 120.0
HEADER = {
    "t": "Time (s)",
    "lever": "PLA (deg)",
    "altitude": "Press Alt (ft)",
    "mach": "Mach",
    "ng": "NG (%)",
    "itt": "ITT (deg C)",
    "np": "Prop Speed (rpm)",
    "torque": "Torque (ft-lb)",
    "power": "Shaft Power (shp)",
}


def settled(lever: FloatArray, altitude: FloatArray, mach: FloatArray) -> FloatArray:
    """Gas generator speed in % at which a lever of 0 to 90 deg settles."""
    air = air_state(altitude, mach)
    return np.asarray((62.0 + 38.0 * lever / 90.0) * np.sqrt(air.theta2))


def flown(seed: int, duration_s: float = 400.0) -> dict[str, FloatArray]:
    """One flight in SI units: lever steps while the aircraft climbs."""
    rng = np.random.default_rng(seed)
    count = round(duration_s * RATE_HZ)
    time_s = np.arange(count) / RATE_HZ
    levels = np.where(np.arange(200) % 2, 70.0, 25.0) + rng.uniform(-20.0, 20.0, 200)
    lever = levels[(time_s // 20.0).astype(int)]
    altitude = np.linspace(1000.0, rng.uniform(8000.0, 16000.0), count)
    mach = np.linspace(0.15, 0.35, count)
    target = settled(lever, altitude, mach)
    air = air_state(altitude, mach)
    ng, absorbed, hot, rpm = target.copy(), np.zeros(count), np.zeros(count), np.zeros(count)
    power = np.zeros(count)
    for k in range(count):
        j = max(k - 1, 0)
        tau_s = 1.4 * (80.0 / ng[j]) ** 2
        ng[k] = ng[j] + (target[j] - ng[j]) * (1.0 - np.exp(-1.0 / (RATE_HZ * tau_s)))
        corrected = ng[k] / np.sqrt(air.theta2[k])
        share = ((corrected - 52.0) / 48.0) ** 2
        power[k] = FULL_KW * share * air.delta2[k] * np.sqrt(air.theta2[k])
        temperature = (700.0 + 380.0 * share) * air.theta2[k] - 273.15
        absorbed[k] = power[k] if k == 0 else absorbed[j] + (power[k] - absorbed[j]) * 0.2
        hot[k] = temperature if k == 0 else hot[j] + (temperature - hot[j]) * 0.25
        held = GOVERNED_RPM * min((absorbed[k] / LEAST_KW) ** (1.0 / 3.0), 1.0)
        rpm[k] = held * (1.0 + 0.15 * (power[k] - absorbed[k]) / FULL_KW)
    torque = power * 1e3 / (rpm * 2.0 * np.pi / 60.0)
    clean = {"ng": ng, "itt": hot, "np": rpm, "torque": torque, "power": power}
    noise = {"ng": 0.03, "itt": 0.8, "np": 1.5, "torque": 8.0, "power": 1.0}
    seen = {name: y + rng.normal(0.0, noise[name], count) for name, y in clean.items()}
    return {"t": time_s, "lever": lever, "altitude": altitude, "mach": mach, **seen}


def write(path: Path, seed: int, duration_s: float = 400.0) -> dict[str, FloatArray]:
    """Write one flight in the recorder's units and header, and return it in SI units."""
    flight = flown(seed, duration_s)
    written = {
        **flight,
        "torque": flight["torque"] / LBF_FT_NM,
        "power": flight["power"] / HP_KW,
    }
    table = pd.DataFrame({HEADER[name]: written[name] for name in HEADER})
    path.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(path, index=False, float_format="%.4f")
    return flight
