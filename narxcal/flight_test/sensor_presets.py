"""Settings of one sensor, and the tables of figures for whole aircraft, each with its source."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from narxcal.settings import Section

Preset = Literal["test_instrumentation", "fdr", "perfect"]


class ChannelSensor(Section):
    """How one channel is measured; 0 everywhere is a perfect sensor.

    tau_s: first-order lag; `meter_reference_kgph`, fuel flow only: the flow at which `tau_s`
        holds, since a turbine meter's is inverse to the flow (0: it is not).
    bias_sigma, gain_sigma, drift_sigma_per_h: of each flight, in the channel's unit, as a share of
        the reading, and in units per hour.
    noise_sigma, noise_share: white noise, in the channel's unit plus as a share of the reading;
        coloured_sigma, coloured_tau_s: noise that lingers (AR(1)).
    skew_s, skew_sigma_s: the recorder's clock late by this much, and its scatter between flights.
    rate_hz, slot_s: sampled so often, this far into each frame, and held; 0 means every row.
    resolution: the step of the readings.
    dropouts_per_h, dropout_s; freezes_per_h, freeze_s; spikes_per_h, spike_size: stretches without
        readings, stretches of one reading, single wild readings.
    """

    tau_s: float = Field(default=0.0, ge=0)
    meter_reference_kgph: float = Field(default=0.0, ge=0)
    bias_sigma: float = Field(default=0.0, ge=0)
    gain_sigma: float = Field(default=0.0, ge=0)
    drift_sigma_per_h: float = Field(default=0.0, ge=0)
    noise_sigma: float = Field(default=0.0, ge=0)
    noise_share: float = Field(default=0.0, ge=0)
    coloured_sigma: float = Field(default=0.0, ge=0)
    coloured_tau_s: float = Field(default=2.0, gt=0)
    skew_s: float = Field(default=0.0, ge=-2, le=2)
    skew_sigma_s: float = Field(default=0.0, ge=0, le=0.5)
    rate_hz: float = Field(default=0.0, ge=0)
    slot_s: float = Field(default=0.0, ge=0)
    resolution: float = Field(default=0.0, ge=0)
    dropouts_per_h: float = Field(default=0.0, ge=0)
    dropout_s: float = Field(default=1.0, gt=0)
    freezes_per_h: float = Field(default=0.0, ge=0)
    freeze_s: float = Field(default=2.0, gt=0)
    spikes_per_h: float = Field(default=0.0, ge=0)
    spike_size: float = Field(default=0.0, ge=0)


# Speeds lag by 0.02 s, pressures by 0.04 s (FACTS A3: the sensors of the AGTF30). White noise is
# that of recorded channels (FACTS A8: N1, N2 0.03-0.1 %, EGT 0.5-2 degC, fuel flow 0.3-1 %).
# Biases, resolutions, the scatter of the clock (a quarter of a 32 Hz sample) and whatever bears no
# source are assumed, small against what the effects of the library do.
_CLOCK_S = 0.008
TEST_INSTRUMENTATION: dict[str, ChannelSensor] = {
    "TRA_deg": ChannelSensor(noise_sigma=0.02, resolution=0.05),
    "ALT_ft": ChannelSensor(noise_sigma=2.0, bias_sigma=10.0, resolution=1.0),
    "Mach": ChannelSensor(noise_sigma=2e-4, bias_sigma=5e-4, resolution=1e-4),
    "dT_C": ChannelSensor(noise_sigma=0.05, bias_sigma=0.2, resolution=0.05),
    "N1_pct": ChannelSensor(
        tau_s=0.02, bias_sigma=0.03, noise_sigma=0.04, skew_sigma_s=_CLOCK_S, resolution=0.02
    ),
    "N2_pct": ChannelSensor(
        tau_s=0.02, bias_sigma=0.03, noise_sigma=0.04, skew_sigma_s=_CLOCK_S, resolution=0.02
    ),
    "EGT_C": ChannelSensor(
        tau_s=0.02,
        bias_sigma=1.0,
        noise_sigma=0.7,
        coloured_sigma=0.3,
        skew_sigma_s=_CLOCK_S,
        resolution=0.5,
    ),
    "FF_kgph": ChannelSensor(
        tau_s=0.1,
        gain_sigma=0.003,
        noise_share=0.004,
        skew_sigma_s=_CLOCK_S,
        resolution=0.5,
    ),
    "FN_kN": ChannelSensor(gain_sigma=0.003, noise_share=0.003),
    "FPR": ChannelSensor(tau_s=0.04, noise_share=0.001, gain_sigma=0.001, resolution=0.001),
    "EPR": ChannelSensor(tau_s=0.04, noise_share=0.001, gain_sigma=0.001, resolution=0.001),
}

# An airline's recorder: engine channels once a second and engine, each in its own slot of the
# frame (FACTS A8, 14 CFR 125 App. E, which allows steps of 2 % of the full range; those below are
# finer, as recorders are). Rates of the other channels and all slots are assumed.
FDR: dict[str, ChannelSensor] = {
    "TRA_deg": ChannelSensor(rate_hz=1.0, slot_s=0.125, noise_sigma=0.05, resolution=0.35),
    "ALT_ft": ChannelSensor(rate_hz=1.0, bias_sigma=15.0, noise_sigma=2.0, resolution=4.0),
    "Mach": ChannelSensor(rate_hz=1.0, slot_s=0.0625, bias_sigma=1e-3, resolution=1e-3),
    "dT_C": ChannelSensor(rate_hz=1.0, slot_s=0.9375, bias_sigma=0.3, resolution=0.25),
    "N1_pct": ChannelSensor(
        tau_s=0.02, rate_hz=1.0, slot_s=0.25, bias_sigma=0.05, noise_sigma=0.05, resolution=0.125
    ),
    "N2_pct": ChannelSensor(
        tau_s=0.02, rate_hz=1.0, slot_s=0.5, bias_sigma=0.05, noise_sigma=0.05, resolution=0.125
    ),
    "EGT_C": ChannelSensor(
        tau_s=0.02, rate_hz=1.0, slot_s=0.75, bias_sigma=2.0, noise_sigma=1.0, resolution=1.0
    ),
    "FF_kgph": ChannelSensor(
        tau_s=0.3,
        rate_hz=1.0,
        slot_s=0.875,
        gain_sigma=0.005,
        noise_share=0.005,
        resolution=2.0,
    ),
    "FPR": ChannelSensor(tau_s=0.04, rate_hz=1.0, slot_s=0.375, resolution=0.005),
    "EPR": ChannelSensor(tau_s=0.04, rate_hz=1.0, slot_s=0.375, resolution=0.005),
    **{
        name: ChannelSensor(rate_hz=1.0, slot_s=0.625)
        for name in ("WOW", "Approach", "ECS", "NAI", "WAI")
    },
}

PRESETS: dict[str, dict[str, ChannelSensor]] = {
    "test_instrumentation": TEST_INSTRUMENTATION,
    "fdr": FDR,
    "perfect": {},
}
# Total temperature probe: a de-iced probe answers in about 1 s (description of the T-28's
# measurements, archive.eol.ucar.edu, 2000).
PROBE_TAU_S: dict[str, float] = {"test_instrumentation": 1.0, "fdr": 1.0, "perfect": 0.0}
