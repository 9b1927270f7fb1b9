"""Elastic laws. The order is the expert index in checkpoints: append only."""

from ..expert import Elastic
from . import fixed_corotated, fluid_eos, hencky, isochoric_neo_hookean, neo_hookean

ELASTIC: dict[str, Elastic] = {
    m.LAW.name: m.LAW for m in (fixed_corotated, neo_hookean, hencky, isochoric_neo_hookean, fluid_eos)
}
