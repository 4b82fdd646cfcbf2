"""Table [steady_state]: which steady-state model, and how a fitted one is fitted."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, field_validator, model_validator

from narxcal.channels import CHANNELS, channel
from narxcal.settings import Section
from narxcal.steady_options import SteadySourceOptions

Kind = Literal["fitted", "table", "callable", "fmu"]
Auto = Literal["auto"]


def known_once(names: tuple[str, ...]) -> tuple[str, ...]:
    """`names`, if all are channels and none stands there twice; for validators of fields."""
    for name in names:
        channel(name)
        if names.count(name) > 1:
            raise ValueError(f"'{name}' is named twice")
    return names


class SteadyFitConfig(Section):
    """How stiff the curves are.

    `knots` of the spline over the driver; `bend`, `spread` and `scatter` are the penalties on
    curvature, on differences between envelope corners and on engine lines, as shares of the
    mean squared error. `huber` is the residual, in robust standard deviations, beyond which a
    sample loses weight; 0 turns that off. The curves go on straight for `reach` of the driver's
    range beyond the samples, and are held from there on; both count as outside the envelope.
    """

    knots: int = Field(default=8, ge=2)
    bend: float = Field(default=1e-3, ge=0)
    spread: float = Field(default=3e-4, ge=0)
    scatter: float = Field(default=1e-4, ge=0)
    huber: float = Field(default=0.0, ge=0)
    reach: float = Field(default=0.15, ge=0)


class SteadyStateConfig(Section):
    """Table [steady_state]: fit a model to the logs, or load the maker's.

    `kind` "fitted" uses `inputs` (which must hold ALT_ft, Mach and dT_C if `corrected`) and
    blends curves over `driver` (that of [events] where it is empty) between the extremes of
    `blend`. `switches` add a line each while they are on; they are inputs whether named there or
    not. What is "auto" is chosen by the training logs (see training.steady_choice). The other
    kinds load `source`: a CSV table, `module:function` or an FMU file.
    """

    kind: Kind = "fitted"
    source: str = ""
    inputs: tuple[str, ...] = Field(default=("TRA_deg", "ALT_ft", "Mach", "dT_C"), min_length=1)
    driver: str = ""
    blend: Auto | tuple[str, ...] = "auto"
    switches: Auto | tuple[str, ...] = "auto"
    corrected: Auto | bool = "auto"
    fit: SteadyFitConfig = SteadyFitConfig()
    options: SteadySourceOptions = SteadySourceOptions()

    @model_validator(mode="after")
    def _consistent(self) -> SteadyStateConfig:
        if self.kind != "fitted" and not self.source:
            raise ValueError(f"kind '{self.kind}' needs a source")
        blend = () if self.blend == "auto" else self.blend
        missing = [name for name in blend if name not in self.inputs]
        if missing:
            raise ValueError(f"blend names '{missing[0]}', which is no input")
        return self

    @field_validator("inputs")
    @classmethod
    def _are_channels(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        return known_once(names)

    @field_validator("switches")
    @classmethod
    def _are_switches(cls, names: Auto | tuple[str, ...]) -> Auto | tuple[str, ...]:
        for name in () if names == "auto" else names:
            if name not in CHANNELS or CHANNELS[name].role != "switch":
                known = ", ".join(each.name for each in CHANNELS.values() if each.role == "switch")
                raise ValueError(f"'{name}' is no switch; switches are {known}")
        return names
