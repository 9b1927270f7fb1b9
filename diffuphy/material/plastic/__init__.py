"""Plastic laws. The order is the expert index in checkpoints: append only."""

from ..expert import Plastic
from . import drucker_prager, fluid, identity, viscoplastic, von_mises

PLASTIC: dict[str, Plastic] = {
    law.name: law
    for law in (
        identity.LAW,
        drucker_prager.LAW,
        von_mises.LAW,
        fluid.LAW,
        viscoplastic.LAW,
        drucker_prager.PLANE_STRAIN,
    )
}
