"""Adapter to the rasteriser of the gsplat package (CUDA only)."""

from dataclasses import dataclass

import torch
from torch import Tensor

from diffuphy.geometry import covariances
from diffuphy.render.image import Image
from diffuphy.types import Camera


@dataclass(frozen=True)
class Gsplat:
    """gsplat's CUDA rasteriser behind the protocol of this package, for large scenes; float32.

    Ye et al., gsplat: an open-source library for Gaussian splatting (2024). Deformed Gaussians reach it as covariances
    Σ = F R S² Rᵀ Fᵀ. It stops a pixel before, not after, the Gaussian that makes it opaque and lets α reach 0.999:
    images differ from :class:`Warp`'s by up to about one grey level.
    """

    dilation: float = 0.3
    """ε added to the diagonal of the 2D covariance [px²]."""
    near: float = 0.01
    """Centres nearer to the camera plane are not drawn [unit of the means]."""

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
        """See :func:`diffuphy.render.rasterize`.

        Raises:
            ModuleNotFoundError: gsplat is not installed.
            ValueError: tensors are not float32 on a CUDA device.
        """
        if means.device.type != "cuda" or means.dtype != torch.float32:
            raise ValueError(
                f"the gsplat backend needs float32 tensors on a CUDA device, got {means.dtype} on {means.device}; "
                "use backend=Warp(), which runs everywhere"
            )
        try:
            from gsplat import rasterization  # pyright: ignore[reportAttributeAccessIssue]  # it sees this file
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(
                'the gsplat backend needs the package gsplat: pip install "diffuphy[gsplat]", or use backend=Warp()',
                name="gsplat",
            ) from error
        covars = None
        if F is not None:
            covars = covariances(quats, scales, F)
        features, alpha, meta = rasterization(
            means=means,
            quats=quats,
            scales=scales,
            opacities=opacities,
            colors=colors,
            viewmats=camera.viewmats.to(means),
            Ks=camera.Ks.to(means),
            width=camera.width,
            height=camera.height,
            near_plane=self.near,
            eps2d=self.dilation,
            packed=False,  # so that means2d keeps its shape (C, G, 2)
            render_mode="RGB+D",
            covars=covars,
        )
        means2d = meta["means2d"]
        if means2d.requires_grad:
            means2d.retain_grad()
        return Image(features[..., :3], alpha[..., 0], features[..., 3], means2d)
