"""Plastic laws. The order is the expert index in checkpoints: append only."""

from ..expert import Plastic
from . import (
    cam_clay,
    drucker_prager,
    fluid,
    herschel_bulkley,
    identity,
    melting,
    viscoplastic,
    von_mises,
    von_mises_hardening,
)

PLASTIC: dict[str, Plastic] = {
    law.name: law
    for law in (
        identity.LAW,
        drucker_prager.LAW,
        von_mises.LAW,
        fluid.LAW,
        viscoplastic.LAW,
        drucker_prager.PLANE_STRAIN,
        von_mises_hardening.LAW,
        herschel_bulkley.LAW,
        cam_clay.LAW,
        melting.LAW,
    )
}
