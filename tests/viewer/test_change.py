"""What is asked for is what is simulated."""

import pytest
import torch

from diffuphy.viewer.change import Change, height_of
from tests.viewer.runs import run


def test_no_change_is_the_film(tmp_path):
    film = run(tmp_path)
    setup = Change(particles=None)(film)
    assert setup.scene == film.play.scene(film.motion, film.particles)
    assert setup.particles is film.particles
    torch.testing.assert_close(setup.field.theta["E"], film.field.theta["E"], rtol=0, atol=0)


def test_what_is_given_replaces_what_the_film_has(tmp_path):
    film = run(tmp_path)
    change = Change(height=1.5, velocity=(1.0, 0.0, 2.0), gravity=1.62, stiffness=10.0, particles=None)
    setup = change(film)
    assert setup.scene.lift == 1.5 and height_of(setup.scene, film.particles) == 1.5
    assert setup.scene.velocity == (1.0, 0.0, 2.0) and setup.scene.gravity == (0.0, 0.0, -1.62)
    torch.testing.assert_close(setup.field.theta["E"], 10.0 * film.field.theta["E"], rtol=0, atol=0)
    torch.testing.assert_close(setup.field.rho, film.field.rho, rtol=0, atol=0)


def test_another_material_is_that_of_the_table(tmp_path):
    setup = Change(material="sand", particles=None)(run(tmp_path))
    assert setup.field.plastic == ("drucker_prager",) and float(setup.field.rho[0]) == 1600.0


def test_a_draft_is_the_same_body_with_fewer_particles(tmp_path):
    """Volume and, the density being uniform, mass are kept; each draft particle has the laws of the one it was."""
    film = run(tmp_path)
    film.field.theta["E"][:] = film.particles.x[:, 0] + 1.0
    setup = Change(particles=100)(film)
    assert 64 <= len(setup.particles) <= 100
    # float32 sums of a few hundred volumes
    torch.testing.assert_close(setup.particles.vol.sum(), film.particles.vol.sum(), rtol=1e-5, atol=0)
    torch.testing.assert_close(setup.field.theta["E"], setup.particles.x[:, 0] + 1.0, rtol=0, atol=0)
    assert setup.scene.dx > film.play.scene(film.motion, film.particles).dx


@pytest.mark.parametrize(
    "change",
    [{"stiffness": 0.0}, {"height": -0.1}, {"gravity": float("nan")}, {"particles": 3}, {"material": "ectoplasm"},
     {"velocity": (0.0, 0.0, float("inf"))}],
)  # fmt: skip
def test_nonsense_is_refused(change):
    with pytest.raises(ValueError, match=r"\S"):
        Change(**change)


def test_a_change_says_what_it_is():
    assert str(Change(particles=None)) == "as in the film"
    told = str(Change(material="jelly", height=1.0, gravity=1.6))
    assert told == "jelly, from 1 m, gravity 1.6 m/s², 2000 particles"
