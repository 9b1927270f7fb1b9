"""The rasteriser once more, in a few lines of torch: dense, slow, exact. The kernels are tested against it.

Zwicker et al., EWA splatting (2002), eq. 29-31; Kerbl et al., 3D Gaussian splatting (2023), eq. 3 and 5.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from diffuphy.geometry import covariances
from diffuphy.render.image import Image
from diffuphy.types import Camera


def project(
    means: Tensor, Sigma: Tensor, viewmat: Tensor, K: Tensor, size: tuple[int, int], dilation: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Centres (G, 2) [px], covariances (G, 2, 2) [px²] and depths (G,) in one view: Σ₂ = J W Σ Wᵀ Jᵀ + ε I.

    J is taken where the ray leaves the image enlarged by 15 % a side, if the centre lies beyond (as in gsplat).
    """
    W, t = viewmat[:3, :3], viewmat[:3, 3]
    p = means @ W.mT + t
    z = p[:, 2]
    focal, centre = torch.stack([K[0, 0], K[1, 1]]), torch.stack([K[0, 2], K[1, 2]])
    extent = means.new_tensor(size)
    slope = p[:, :2] / z[:, None]
    slope_J = torch.clamp(slope, -(centre + 0.15 * extent) / focal, (extent - centre + 0.15 * extent) / focal)
    J = torch.zeros(len(means), 2, 3, dtype=means.dtype, device=means.device)
    J = J + torch.diag_embed(focal / z[:, None])[:, :, [0, 1, 1]] * means.new_tensor([1, 1, 0])
    J = J - (focal * slope_J / z[:, None])[:, :, None] * means.new_tensor([0, 0, 1])
    JW = J @ W
    covariance2d = JW @ Sigma @ JW.mT + dilation * torch.eye(2, dtype=means.dtype, device=means.device)
    return focal * slope + centre, covariance2d, z


def composite(
    means2d: Tensor,
    covariances2d: Tensor,
    features: Tensor,
    opacities: Tensor,
    size: tuple[int, int],
    thresholds: tuple[float, float, float],
) -> tuple[Tensor, Tensor]:
    """Features (H, W, D) and coverage (H, W) of Gaussians in the order given, nearest first.

    Args:
        thresholds: α_min, α_max, T_min, see :class:`diffuphy.render.Warp`.
    """
    alpha_min, alpha_max, T_min = thresholds
    width, height = size
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    pixels = torch.stack([x, y], dim=-1).reshape(-1, 2).to(means2d) + 0.5
    d = pixels - means2d[:, None]  # (G, HW, 2)
    power = -0.5 * torch.einsum("gpi,gij,gpj->gp", d, torch.linalg.inv(covariances2d), d)
    alpha = (opacities[:, None] * torch.exp(power)).clamp_max(alpha_max)
    alpha = torch.where(alpha >= alpha_min, alpha, 0)
    T = torch.cat([torch.ones_like(alpha[:1]), torch.cumprod(1 - alpha, dim=0)])[:-1]
    weight = alpha * T * (T >= T_min)
    return (weight.mT @ features).reshape(height, width, -1), weight.sum(0).reshape(height, width)


@dataclass(frozen=True)
class Dense:
    """Reference rasteriser: every Gaussian at every pixel. Memory grows as C · G · H · W; for tests and small
    pictures."""

    dilation: float = 0.3
    """ε added to the diagonal of the 2D covariance [px²]."""
    near: float = 0.01
    """Centres nearer to the camera plane are not drawn [unit of the means]."""
    alpha_min: float = 1 / 255
    """Contributions below this opacity are left out [-]."""
    alpha_max: float = 0.99
    """Largest opacity of one Gaussian at a pixel [-]."""
    T_min: float = 1e-4
    """A pixel is finished when it transmits less than this [-]."""

    def __call__(
        self,
        means: Tensor,
        quats: Tensor,
        scales: Tensor,
        opacities: Tensor,
        colors: Tensor,
        camera: Camera,
        F: Tensor | None = None,
    ) -> Image:
        """See :func:`diffuphy.render.rasterize`."""
        size = (camera.width, camera.height)
        Sigma = covariances(quats, scales, F)
        views = []
        for c in range(len(camera)):
            view, K = camera.viewmats[c].to(means), camera.Ks[c].to(means)
            depth = (means @ view[:3, :3].mT + view[:3, 3])[:, 2].detach()
            order = torch.argsort(depth, stable=True)
            order = order[depth[order] > self.near]
            means2d, covariances2d, z = project(means[order], Sigma[order], view, K, size, self.dilation)
            color = (colors[c] if colors.dim() == 3 else colors)[order]
            features, alpha = composite(
                means2d,
                covariances2d,
                torch.cat([color, z[:, None]], dim=1),
                opacities[order],
                size,
                (self.alpha_min, self.alpha_max, self.T_min),
            )
            everywhere = means.new_zeros(len(means), 2).index_copy(0, order, means2d)
            views.append((features[..., :3], alpha, features[..., 3], everywhere))
        return Image(*(torch.stack(parts) for parts in zip(*views, strict=True)))
