"""Static models of thrust, fuel flow and pressure ratios, grey box and black box."""

from narxcal.static_models.black_box import corrected, outside, polynomial, spline_table, tensor
from narxcal.static_models.fuel import bada3, torenbeek_fuel, yoder, yoder_plus
from narxcal.static_models.model import MODELS, Parameter, StaticModel, build, component_level
from narxcal.static_models.thrust import (
    aerospatiale,
    cold_thrust,
    mattingly,
    torenbeek,
    wanner,
    with_drag,
)

__all__ = [
    "MODELS",
    "Parameter",
    "StaticModel",
    "aerospatiale",
    "bada3",
    "build",
    "cold_thrust",
    "component_level",
    "corrected",
    "mattingly",
    "outside",
    "polynomial",
    "spline_table",
    "tensor",
    "torenbeek",
    "torenbeek_fuel",
    "wanner",
    "with_drag",
    "yoder",
    "yoder_plus",
]
