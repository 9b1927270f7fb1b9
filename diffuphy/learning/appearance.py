"""What the material network sees of a particle: the Gaussian it carries."""

import math

import torch

from diffuphy.geometry import log_covariances
from diffuphy.material.encoder import Points, features
from diffuphy.material.patches import nearest
from diffuphy.render import sh
from diffuphy.types import Gaussians, Particles


def appearance(gaussians: Gaussians, particles: Particles) -> Points:
    """Position, covariance, opacity, colour and sheen of each particle's Gaussian; of the nearest one for interior
    filler.

        sheen² = 1/(4π) Σ_{l ≥ 1} Σ_m c_lm²

    Sheen is the standard deviation of the colour over the directions it is seen from: the norm of a band of harmonics
    is what a rotation leaves of it.
    """
    means = gaussians.means * particles.scale + particles.x.new_tensor(particles.offset)
    index = particles.gaussian.clone()
    filler = index < 0
    if bool(filler.any()):
        index[filler] = nearest(particles.x[filler], means, 1)[1][:, 0]
    log_scales = gaussians.log_scales[index] + math.log(particles.scale)
    log_cov = log_covariances(gaussians.quats[index], log_scales)
    colors = sh.to_rgb(gaussians.sh[index]).clamp(0, 1)
    opacities = gaussians.logit_opacities[index].sigmoid()
    rest = gaussians.sh[index, 1:]
    sheen = (rest.square().sum((1, 2)) / (4 * math.pi)).sqrt() if rest.shape[1] else torch.zeros_like(opacities)
    return features(particles.x, colors, opacities, log_cov, sheen)
