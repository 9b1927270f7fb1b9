"""The two functions that draw Gaussians."""

from torch import Tensor

from diffuphy.render import sh
from diffuphy.render.image import Image, Rasteriser, check, check_ranges
from diffuphy.render.raster import Warp
from diffuphy.types import Camera, Gaussians

WARP = Warp()


def rasterize(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    camera: Camera,
    *,
    F: Tensor | None = None,
    backend: Rasteriser = WARP,
) -> Image:
    """Draw G Gaussians with covariance Σ = F R S² Rᵀ Fᵀ from C cameras; differentiable in every tensor but the camera.

    Zwicker et al., EWA splatting (2002); Kerbl et al., 3D Gaussian splatting (2023).

    Args:
        means: centres (G, 3) in the unit of the camera's translations.
        quats: orientations wxyz, of any length but zero (G, 4).
        scales: standard deviations (G, 3), linear.
        opacities: (G,) in [0, 1].
        colors: rgb (G, 3), or (C, G, 3) for one colour a view.
        F: deformation gradients (G, 3, 3); none is the identity and costs nothing.
        backend: the rasteriser.

    Raises:
        ValueError: wrong shape, dtype or device, opacity out of range, or a value that is not finite (field and
            index are named).
    """
    fields = {"means": means, "quats": quats, "scales": scales, "opacities": opacities, "colors": colors}
    count = len(means)
    shapes: dict[str, tuple[tuple[int, ...], ...]] = {
        "means": ((count, 3),),
        "quats": ((count, 4),),
        "scales": ((count, 3),),
        "opacities": ((count,),),
        "colors": ((count, 3), (len(camera), count, 3)),
        "F": ((count, 3, 3),),
    }
    if F is not None:
        fields["F"] = F
    check(fields, shapes)
    check_ranges(quats, opacities)
    return backend(means, quats, scales, opacities, colors, camera, F)


def render_gaussians(
    gaussians: Gaussians,
    camera: Camera,
    *,
    means: Tensor | None = None,
    F: Tensor | None = None,
    background: Tensor | None = None,
    backend: Rasteriser = WARP,
) -> Image:
    """Draw ``gaussians``, optionally moved to ``means`` (G, 3) and deformed by ``F`` (G, 3, 3).

    Args:
        background: (3,), (H, W, 3) or (C, H, W, 3); the image's rgb then stands on it instead of on black.
    """
    means = gaussians.means if means is None else means
    colors = sh.colors(gaussians.sh, means, camera, F)
    image = rasterize(
        means,
        gaussians.quats,
        gaussians.log_scales.exp(),
        gaussians.logit_opacities.sigmoid(),
        colors,
        camera,
        F=F,
        backend=backend,
    )
    return image if background is None else Image(image.over(background), image.alpha, image.depth, image.means2d)
