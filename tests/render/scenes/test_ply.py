"""The .ply layout of 3D Gaussian splatting."""

import struct
from pathlib import Path

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from diffuphy.render import orbit, render_gaussians
from diffuphy.render.scenes import ply
from diffuphy.types import Gaussians


def make(count: int, degree: int, seed: int = 0) -> Gaussians:
    g = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=g)

    return Gaussians(
        normal(count, 3), normal(count, 4), normal(count, 3), normal(count), normal(count, (degree + 1) ** 2, 3)
    )


FIELDS = ("means", "quats", "log_scales", "logit_opacities", "sh")


@given(
    degree=st.integers(0, 3),
    table=arrays.arrays(
        "<f4",
        st.tuples(st.integers(0, 5), st.just(59)),
        elements=st.floats(allow_nan=False, allow_infinity=False, width=32),
    ),
)
def test_round_trip_keeps_every_bit(degree: int, table, tmp_path_factory) -> None:
    """read(write(g)) = g, bit for bit, when the axes are kept."""
    t = torch.from_numpy(table.copy())
    k = (degree + 1) ** 2
    g = Gaussians(t[:, :3], t[:, 3:7], t[:, 7:10], t[:, 10], t[:, 11 : 11 + 3 * k].reshape(-1, k, 3))
    path = tmp_path_factory.mktemp("ply") / "g.ply"
    ply.write(path, g, up="z_up")
    back = ply.read(path, up="z_up")
    for name in FIELDS:
        assert torch.equal(getattr(back, name), getattr(g, name)), name


@pytest.mark.parametrize("up", ["z_up", "y_up", "y_down"])
@pytest.mark.parametrize("degree", [0, 3])
def test_round_trip_through_other_axes(up: str, degree: int, tmp_path: Path) -> None:
    """Turning there and back loses rounding only: quaternions may change by 2 ulp, coefficients by the condition of
    the fit."""
    g = make(20, degree)
    ply.write(tmp_path / "g.ply", g, up=up)
    back = ply.read(tmp_path / "g.ply", up=up)
    for name in FIELDS:
        torch.testing.assert_close(getattr(back, name), getattr(g, name), rtol=1e-5, atol=1e-5)


def test_bytes_are_those_of_the_original_implementation(tmp_path: Path) -> None:
    """Header, order and channel-major f_rest as ``scene/gaussian_model.py: save_ply`` of Kerbl et al. writes them."""
    count = 2
    value = torch.arange(count * 100, dtype=torch.float32).reshape(count, 100)
    g = Gaussians(value[:, :3], value[:, 3:7], value[:, 7:10], value[:, 10], value[:, 20:32].reshape(count, 4, 3))
    ply.write(tmp_path / "g.ply", g, up="z_up")
    names = "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2".split() + [f"f_rest_{i}" for i in range(9)]
    names += "opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split()
    expected = "ply\nformat binary_little_endian 1.0\nelement vertex 2\n"
    expected = (expected + "".join(f"property float {n}\n" for n in names) + "end_header\n").encode()
    for r in range(count):
        dc = g.sh[r, 0].tolist()
        rest = [g.sh[r, k, c].item() for c in range(3) for k in range(1, 4)]
        row = [*g.means[r].tolist(), 0, 0, 0, *dc, *rest, g.logit_opacities[r].item()]
        row += [*g.log_scales[r].tolist(), *g.quats[r].tolist()]
        expected += struct.pack(f"<{len(row)}f", *row)
    assert (tmp_path / "g.ply").read_bytes() == expected


@pytest.mark.parametrize(("up", "axis"), [("z_up", (0, 0, 1)), ("y_up", (0, 1, 0)), ("y_down", (0, -1, 0))])
def test_up_is_where_it_says(up: str, axis: tuple, tmp_path: Path) -> None:
    g = make(1, 0)
    g = Gaussians(torch.tensor([[0.0, 0.0, 1.0]]), g.quats, g.log_scales, g.logit_opacities, g.sh)
    ply.write(tmp_path / "g.ply", g, up=up)
    torch.testing.assert_close(
        ply.read(tmp_path / "g.ply", up="z_up").means[0], torch.tensor(axis, dtype=torch.float32)
    )


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_turning_the_gaussians_is_turning_the_camera(quarters: int) -> None:
    """render(turned(g), camera) = render(g, camera turned along), with colours of degree 3."""
    g = make(30, 3)
    g = Gaussians(0.3 * g.means, g.quats, g.log_scales - 3, g.logit_opacities, g.sh)
    camera = orbit([20.0], [10.0], 3.0, width=32, height=32)
    c, s = [(1, 0), (0, 1), (-1, 0), (0, -1)][quarters]
    turn = torch.eye(4)
    turn[:3, :3] = torch.tensor([[1.0, 0, 0], [0, c, -s], [0, s, c]])
    along = type(camera)(camera.viewmats @ turn, camera.Ks, 32, 32)
    ours = render_gaussians(ply.turned(g, quarters), camera).rgb
    # colours of about 3, rounded at 1e-6 by the fit of the coefficients
    torch.testing.assert_close(ours, render_gaussians(g, along).rgb, rtol=1e-4, atol=2e-4)


def test_other_programs_files_are_read(tmp_path: Path) -> None:
    """Any order, extra properties, doubles, big-endian, and elements after the vertices."""
    g = make(2, 0)
    names = ["extra", *reversed(ply.names(0))]
    values = dict(zip(["x", "y", "z"], g.means.T.tolist(), strict=True))
    values |= dict(zip(["f_dc_0", "f_dc_1", "f_dc_2"], g.sh[:, 0].T.tolist(), strict=True))
    values |= dict(zip(["scale_0", "scale_1", "scale_2"], g.log_scales.T.tolist(), strict=True))
    values |= dict(zip(["rot_0", "rot_1", "rot_2", "rot_3"], g.quats.T.tolist(), strict=True))
    values |= {"opacity": g.logit_opacities.tolist()}
    header = "ply\nformat binary_big_endian 1.0\ncomment made elsewhere\nelement vertex 2\n"
    header += (
        "".join(f"property double {n}\n" for n in names) + "element face 0\nproperty list uchar int i\nend_header\n"
    )
    body = b"".join(struct.pack(f">{len(names)}d", *[values.get(n, [9.0, 9.0])[r] for n in names]) for r in range(2))
    (tmp_path / "g.ply").write_bytes(header.encode() + body)
    back = ply.read(tmp_path / "g.ply", up="z_up")
    for name in FIELDS:
        assert torch.equal(getattr(back, name), getattr(g, name)), name


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("parted", [" ", "\n", "\t "])
def test_text_is_read_like_bytes(end: str, parted: str, tmp_path: Path) -> None:
    """Nine digits determine a float32: the ASCII file gives the same bits, wherever its lines break, and what follows
    the vertices is not looked at. 3000 Gaussians are longer than what is read at once."""
    import numpy as np

    g = make(3000, 1)
    ply.write(tmp_path / "g.ply", g)
    head, _, body = (tmp_path / "g.ply").read_bytes().partition(b"end_header\n")
    head = head.replace(b"binary_little_endian", b"ascii") + b"element face 1\nproperty list uchar int i\nend_header\n"
    numbers = [f"{v:.9g}" for v in np.frombuffer(body, "<f4")]
    written = parted.join([*numbers, "3", "0", "1", "2"]) + end
    (tmp_path / "t.ply").write_bytes(head.replace(b"\n", end.encode()) + written.encode())
    ours, theirs = ply.read(tmp_path / "t.ply"), ply.read(tmp_path / "g.ply")
    for name in FIELDS:
        assert torch.equal(getattr(ours, name), getattr(theirs, name)), name


def test_higher_harmonics_are_left_out_when_asked(tmp_path: Path) -> None:
    """Degree 4, which some trainers write, is read to degree 3 if so asked and refused otherwise; the channels of a
    lower degree are those of the file."""
    g = make(5, 3)
    ply.write(tmp_path / "g.ply", g, up="z_up")
    for degree in range(4):
        back = ply.read(tmp_path / "g.ply", up="z_up", degree=degree)
        assert torch.equal(back.sh, g.sh[:, : (degree + 1) ** 2])
    more = Gaussians(g.means, g.quats, g.log_scales, g.logit_opacities, torch.cat([g.sh, g.sh[:, :9]], dim=1))
    ply.write(tmp_path / "more.ply", more, up="z_up")
    assert torch.equal(ply.read(tmp_path / "more.ply", up="z_up", degree=3).sh, g.sh)
    with pytest.raises(ValueError, match="degree 4; give degree=3"):
        ply.read(tmp_path / "more.ply")


def test_errors_say_what_is_wrong(tmp_path: Path) -> None:
    path = tmp_path / "g.ply"
    g = make(3, 0)
    ply.write(path, g)
    data = path.read_bytes()
    path.write_bytes(data[:-1])
    with pytest.raises(ValueError, match="cut off"):
        ply.read(path)
    path.write_bytes(data.replace(b"property float opacity\n", b"property float opaque_\n"))
    with pytest.raises(ValueError, match="properties opacity are missing"):
        ply.read(path)
    path.write_bytes(data.replace(b"binary_little_endian", b"binary"))
    with pytest.raises(ValueError, match="format 'binary'; binary_little_endian, binary_big_endian, ascii are read"):
        ply.read(path)
    path.write_bytes(b"GIF89a")
    with pytest.raises(ValueError, match=r"not a \.ply file"):
        ply.read(path)
    with pytest.raises(ValueError, match="up must be one of"):
        ply.write(path, g, up="x_up")
    g.means[1, 2] = float("nan")
    with pytest.raises(ValueError, match=r"z of Gaussian 1 is nan"):
        ply.write(path, g, up="z_up")
