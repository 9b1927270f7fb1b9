"""A ball whose colour is its normal: a references component with closed-form pictures, for tests only."""

import math
from dataclasses import dataclass

import torch


@dataclass(frozen=True)
class BeachBall:
    """``variants`` balls about the origin that differ in hue; pictures by intersecting rays with the sphere, ``aa``²
    rays a pixel."""

    radius: float = 0.8
    variants: int = 1
    aa: int = 3

    def __call__(self, look, camera, background):
        rgb, alpha = self.render(camera)  # (C, K, H, W, 3), (C, 1, H, W)
        images = rgb + (1 - alpha[..., None]) * background
        return images, torch.zeros(self.variants)

    def object(self, look):
        return self

    def colours(self, normals):
        turns = torch.arange(self.variants) * (2 * math.pi / 3 / self.variants)
        return torch.stack([0.5 + 0.4 * (3 * normals + a).sin() for a in turns])  # (K, ..., 3)

    def surface(self, n, generator):
        x = torch.randn(n, 3, generator=generator)
        x = x / x.norm(dim=1, keepdim=True)
        return self.radius * x, self.colours(x)[0]

    def render(self, camera):
        """(rgb premultiplied (C, K, H, W, 3), alpha (C, 1, H, W))."""
        h, w, a = camera.height, camera.width, self.aa
        R, position = (
            camera.viewmats[:, :3, :3],
            -torch.einsum("cji,cj->ci", camera.viewmats[:, :3, :3], camera.viewmats[:, :3, 3]),
        )
        y, x = torch.meshgrid((torch.arange(h * a) + 0.5) / a, (torch.arange(w * a) + 0.5) / a, indexing="ij")
        rays = torch.stack([x, y, torch.ones_like(x)], -1)  # (H, W, 3) px
        d = torch.einsum("cji,cjk,hwk->chwi", R, torch.linalg.inv(camera.Ks), rays)
        d = d / d.norm(dim=-1, keepdim=True)
        b = (d * position[:, None, None]).sum(-1)
        disc = b**2 - (position**2).sum(-1)[:, None, None] + self.radius**2
        hit = (disc > 0).float()
        normals = (position[:, None, None] + d * (-b - disc.clamp_min(0).sqrt())[..., None]) / self.radius
        rgb = self.colours(normals).movedim(0, 1) * hit[:, None, ..., None]

        def pool(z):
            return z.unflatten(2, (h, a)).mean(3).unflatten(3, (w, a)).mean(4)

        return pool(rgb), pool(hit[:, None])
