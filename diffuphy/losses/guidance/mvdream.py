"""Four views at once: MVDream (Shi et al. 2024), the multi-view prior of the paper."""

import functools
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from diffuphy.losses.estimators import ddim
from diffuphy.losses.guidance import Layout
from diffuphy.losses.guidance.latent import LatentDiffusion, Texts
from diffuphy.types import Camera, Look, Motion

VIEWS = 4
"""Views of one object that the published model was trained on, and judges together."""


def camera_numbers(camera: Camera) -> Tensor:
    """What the model is told of each camera: its pose row by row, shape (C, 16).

    Camera to world in the axes of Blender and OpenGL (x right, y up, z towards the viewer; world z up), with the
    centre of projection moved onto the unit sphere: distance and field of view are not told. The world is ours: in the
    model's own examples the picture of the front is taken from +x (``camera_azim=90`` of its ``get_camera``, whose
    azimuth begins at −y), and azimuth grows towards +y.

        M = [Rᵀ diag(1, −1, −1), c/‖c‖; 0 0 0 1],   c = −Rᵀ t
    """
    R, t = camera.viewmats[:, :3, :3], camera.viewmats[:, :3, 3]
    pose = torch.eye(4, dtype=R.dtype, device=R.device).repeat(len(camera), 1, 1)
    pose[:, :3, :3] = R.mT * R.new_tensor([1.0, -1.0, -1.0])  # OpenCV's y and z point the other way
    pose[:, :3, 3] = torch.nn.functional.normalize(-torch.einsum("cji,cj->ci", R, t), dim=1)
    return pose.flatten(1)


@dataclass(frozen=True)
class MVDream(LatentDiffusion):
    """Multi-view prior: four pictures of one object, 90° apart at one elevation, are denoised as one sample.

    Sees the object from all sides, so that no side grows a second face; costs one call for four views of 256 px.
    """

    layout: ClassVar[Layout] = "views"
    together: ClassVar[int] = VIEWS

    model: str = "ashawkey/mvdream-sd2.1-diffusers"
    """Hub id or folder. Its own class for the denoiser is not needed and not run."""
    size: int = 256
    """Side the pictures are resized to [px], a multiple of 8: what the model was trained on."""
    cfg: float = 50.0
    """Guidance scale of the authors' text to 3D."""
    rescale: float = 0.5
    """Share of rescaled contrast, likewise."""
    suffix: str = ", 3d asset"
    """Appended to the words: what the captions of the 3D models it was trained on ended with."""

    def skeleton(self, part: str) -> Any:
        from diffuphy.losses.guidance import mvdream_unet

        return mvdream_unet.build(self.settings(part), VIEWS) if part == "unet" else super().skeleton(part)

    def load_unet(self) -> Any:
        from diffuphy.losses.guidance import mvdream_unet

        load = functools.partial(mvdream_unet.from_pretrained, views=VIEWS)
        return self._load(load, "unet", dtype=getattr(torch, self.dtype))

    def condition(
        self, words: Look | Motion, camera: Camera, background: Tensor, *, generator: torch.Generator | None = None
    ) -> Texts:
        """Embedding of the words, and the cameras, whose number must be a multiple of four: rings, one after another.

        Raises:
            ValueError: another number of cameras.
        """
        if len(camera) % VIEWS:
            raise ValueError(
                f"mvdream judges {VIEWS} views together, got {len(camera)}; set fit.views={VIEWS} and "
                f"fit.cameras.ring={VIEWS}"
            )
        texts = self.texts([words.text + self.suffix] * len(camera), words.negative, background.device)
        return texts._replace(labels=camera_numbers(camera))

    def encode(self, sample: Tensor) -> Tensor:
        """Latents (B, 4, size/8, size/8) of pictures (B, H, W, 3) in [0, 1], float32, differentiable."""
        return self.encode_frames(sample, self.size)

    @torch.no_grad()
    def decode_frames(self, z: Tensor) -> Tensor:
        """Frames (n, H, W, 3) in [0, 1] of latents (n, C, h, w), one by one; what lies outside is cut off."""
        with self.use("vae", z.device) as vae:
            x = torch.cat([vae.decode(frame[None] / vae.config.scaling_factor).sample for frame in z])
        return (x / 2 + 0.5).clamp(0, 1).permute(0, 2, 3, 1)

    @torch.no_grad()
    def pictures(
        self, words: Look, camera: Camera, generator: torch.Generator, steps: int = 30, *, cfg: float = 7.5
    ) -> Tensor:
        """Pictures of one object from these cameras, shape (C, size, size, 3) in [0, 1], sampled by DDIM.

            z_T ~ N(0, I),   t_j = j/steps − 1/2n, j = steps … 1,   z_0 = x̂₀(z_{t_1})

        Song et al. (2021) with η = 0; the times end at the last of the model's n steps, as they should for a sample
        that begins as noise (Lin et al. 2023, section 3.3).

        Args:
            words: what they show.
            camera: four cameras, 90° apart (or several rings of four: as many objects).
            generator: source of z_T.
            steps: calls of the network.
            cfg: guidance scale of sampling.
        """
        if steps < 1:
            raise ValueError(f"steps must be at least 1, got {steps}")
        device = camera.viewmats.device
        cond = self.condition(words, camera, torch.ones(3, device=device), generator=generator)
        latent = (len(camera), *self.latent_shape(self.size))
        z = torch.randn(latent, generator=generator, device=generator.device).to(device)
        half = 0.5 / len(self.noise()[0])
        for j in range(steps, 0, -1):
            t, to = (torch.full((len(z),), k / steps - half, device=device) for k in (j, j - 1))
            epsilon = self.guided(z, t, cond, cfg)
            alpha, sigma = (a.to(z).view(-1, 1, 1, 1) for a in self.schedule(t))
            z = ddim(self, z, epsilon, t, to) if j > 1 else (z - sigma * epsilon) / alpha
        return self.decode_frames(z)
