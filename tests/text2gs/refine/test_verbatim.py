"""No refinement: single words, and nothing between them."""

import pytest

from diffuphy.text2gs.refine.verbatim import Verbatim
from diffuphy.workspace import Workspace


def test_the_words_themselves_are_what_a_prior_reads():
    found = Verbatim("a  burger with a jelly patty, made of rubber, dropped")(work=Workspace())
    assert found.look.text == found.motion.text == "a burger with a jelly patty, made of rubber, dropped"


def test_single_words_are_all_that_physics_is_told():
    """The first material word is the whole object's, although it is the patty's; sizes are not read."""
    found = Verbatim("a huge burger with a jelly patty, made of rubber, dropped")(work=Workspace())
    assert found.look.subject == "burger"
    assert found.motion.materials == {"": "jelly"} and found.motion.verb == "falling" and found.motion.size == 0.5


def test_what_is_not_said_keeps_the_object_s_default():
    found = Verbatim("pancakes")(work=Workspace())
    assert found.motion.materials == {"": "pancake"} and found.motion.verb == "falling"


def test_an_unknown_object_is_its_own_sentence():
    assert Verbatim("an old boot")(work=Workspace()).look.subject == "an old boot"


@pytest.mark.parametrize(("settings", "message"), [({"prompt": " "}, "empty"), ({"default_size": 0.0}, "default_size")])
def test_nonsense_is_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        Verbatim(**({"prompt": "a duck"} | settings))(work=Workspace())
