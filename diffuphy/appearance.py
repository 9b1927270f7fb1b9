"""What the material network sees of a particle: the Gaussian it carries."""

from diffuphy.geometry import covariances
from diffuphy.material.encoder import Points, features
from diffuphy.material.patches import nearest
from diffuphy.render import sh
from diffuphy.types import Gaussians, Particles


def appearance(gaussians: Gaussians, particles: Particles) -> Points:
    """Position, covariance, opacity and colour of each particle's Gaussian; of the nearest one for interior filler."""
    means = gaussians.means * particles.scale + particles.x.new_tensor(particles.offset)
    index = particles.gaussian.clone()
    filler = index < 0
    if bool(filler.any()):
        index[filler] = nearest(particles.x[filler], means, 1)[1][:, 0]
    scales = gaussians.log_scales[index].exp() * particles.scale
    colors = (0.5 + sh.C0 * gaussians.sh[index, 0]).clamp(0, 1)
    opacities = gaussians.logit_opacities[index].sigmoid()
    return features(particles.x, colors, opacities, covariances(gaussians.quats[index], scales))
