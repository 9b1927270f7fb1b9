"""Packed Gaussians. ``packed/sixty.spz`` and ``version4.spz`` are what splat-transform 2.7.1 makes of ``sixty()``."""

import gzip
import struct
from pathlib import Path

import pytest
import torch

from diffuphy.geometry import covariances
from diffuphy.render.scenes import capture, ply, spz
from diffuphy.types import Gaussians

PACKED = Path(__file__).parent / "packed"


def sixty() -> Gaussians:
    """Sixty Gaussians of degree 2, z up; they were written with y down."""
    r, n = torch.Generator().manual_seed(0), 60
    quats = torch.nn.functional.normalize(torch.randn(n, 4, generator=r), dim=1)
    means, scales = torch.randn(n, 3, generator=r), -3 + 0.5 * torch.randn(n, 3, generator=r)
    return Gaussians(means, quats, scales, torch.randn(n, generator=r), 0.3 * torch.randn(n, 9, 3, generator=r))


def test_what_another_program_packed_is_read():
    """Positions to half of 2⁻¹² and a rounding, scales to half of 1/16, opacities to half of 1/255; covariances as
    scales, twice, and 9 bits of orientation; colours to half of 1/(255 · 0.15), harmonics to half of the 16 levels that
    are kept of them, on their range of ±1."""
    g, found = sixty(), capture.read(PACKED / "sixty.spz")
    assert spz.header(PACKED / "sixty.spz") == (3, 60, 2, 12) and capture.count(PACKED / "sixty.spz") == 60
    torch.testing.assert_close(found.means, g.means, rtol=0, atol=2**-13 + 1e-6)
    torch.testing.assert_close(found.log_scales, g.log_scales, rtol=0, atol=1 / 32 + 1e-5)
    torch.testing.assert_close(found.logit_opacities.sigmoid(), g.logit_opacities.sigmoid(), rtol=0, atol=0.51 / 255)
    a, b = (covariances(h.quats, h.log_scales.exp()) for h in (found, g))
    size = g.log_scales.exp().amax(1).square()[:, None, None]
    assert float(((a - b) / size).abs().amax()) < 2 * (1 / 32) * 1.1 + 4 * 2 / 511
    torch.testing.assert_close(found.sh[:, 0], g.sh[:, 0], rtol=0, atol=0.5 / (255 * 0.15) + 1e-5)
    # in the axes of the file, where they were cut to ±1 and rounded
    there, kept = ply.turned(g, 1).sh[:, 1:], capture.read(PACKED / "sixty.spz", up="z_up").sh[:, 1:]
    inside = there.abs() < 0.9
    assert float((kept - there)[inside].abs().amax()) < 0.5 / 8 + 0.5 / 128


def test_a_lower_degree_is_kept_if_asked():
    whole, some = (capture.read(PACKED / "sixty.spz", degree=d) for d in (None, 1))
    assert some.sh.shape == (60, 4, 3) and torch.equal(some.sh, whole.sh[:, :4])


def pack(rows: bytes, *, version: int = 2, count: int = 1, degree: int = 0, bits: int = 8) -> bytes:
    return gzip.compress(struct.pack("<IIIBBBB", spz.MAGIC, version, count, degree, bits, 0, 0) + rows)


def test_version_2_has_orientations_of_three_bytes(tmp_path):
    """One Gaussian by hand: x = −1, y = 2⁻⁸, z = 0 in steps of 2⁻⁸, y and z turned back; scale −10 + 32/16; a quarter
    turn about x, √½ ≈ 90/127.5."""
    place = (-256).to_bytes(3, "little", signed=True) + (1).to_bytes(3, "little") + bytes(3)
    rows = place + bytes([128]) + bytes([255, 0, 128]) + bytes([32] * 3) + bytes([218, 127, 127])
    (tmp_path / "a.spz").write_bytes(pack(rows))
    g = spz.read(tmp_path / "a.spz", up="z_up")
    torch.testing.assert_close(g.means, torch.tensor([[-1.0, -(2.0**-8), 0.0]]))
    torch.testing.assert_close(g.log_scales, torch.full((1, 3), -8.0))
    torch.testing.assert_close(g.sh[0, 0, :2], torch.tensor([1.0, -1.0]) / 0.3)
    # half a turn about x after a quarter one: three quarters, ±(−√½, √½, 0, 0), in steps of 1/127.5
    turn = g.quats[0] * g.quats[0, 1].sign()
    torch.testing.assert_close(turn, torch.tensor([-0.7071, 0.7071, 0.0, 0.0]), rtol=0, atol=1 / 127.5)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "no .spz file"),
        (b"no gzip at all", "no .spz file"),
        (gzip.compress(b"short"), "no .spz file"),
        (gzip.compress(bytes(64)), "no .spz file"),
        (pack(b"", version=1), "version 1"),
        (pack(b"", degree=4), "degree 4"),
        (pack(b"", bits=25), "25 fractional bits"),
        (pack(b"", count=2**32 - 1), "cut off"),
        (pack(bytes(18)), "cut off"),
        (pack(bytes(19))[:-12], "no .spz file|cut off"),
    ],
)
def test_broken_files_are_refused_in_one_line(data, says, tmp_path):
    (tmp_path / "a.spz").write_bytes(data)
    with pytest.raises(ValueError, match=says) as e:
        capture.read(tmp_path / "a.spz")
    assert "\n" not in str(e.value)


def test_a_stream_that_swells_is_not_inflated_beyond_its_promise(tmp_path):
    """A megabyte of zeros after one Gaussian is not looked at: what is read is what the header says."""
    (tmp_path / "a.spz").write_bytes(pack(bytes(19) + bytes(2**20)))
    assert len(spz.read(tmp_path / "a.spz")) == 1


def test_version_4_names_the_way_out():
    with pytest.raises(ValueError, match="--spz-version 3"):
        capture.count(PACKED / "version4.spz")
