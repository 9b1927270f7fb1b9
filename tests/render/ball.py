"""A ball of random Gaussians, as tests need it."""

import torch
from torch import Tensor


def ball(count: int, dtype: torch.dtype = torch.float64, *, size: float = 1.0, seed: int = 0) -> dict[str, Tensor]:
    """Operands of ``rasterize``: centres in a thick shell of radius 1, footprints that cover it, every orientation."""
    g = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=g, dtype=torch.float64)

    d = torch.nn.functional.normalize(normal(count, 3), dim=1)
    operands = {
        "means": d * (0.7 + 0.3 * torch.rand(count, 1, generator=g, dtype=torch.float64)),
        "quats": normal(count, 4),
        "scales": size * 1.2 * count**-0.5 * torch.exp(0.3 * normal(count, 3)),
        "opacities": torch.sigmoid(1.5 * normal(count) + 0.5),
        "colors": torch.rand(count, 3, generator=g, dtype=torch.float64),
        "F": torch.eye(3, dtype=torch.float64) + 0.2 * normal(count, 3, 3),
    }
    return {name: x.to(dtype) for name, x in operands.items()}
