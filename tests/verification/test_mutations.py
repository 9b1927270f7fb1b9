"""Mistakes put into the solver are noticed by the suite."""

import pytest

from benchmarks.verification import CASES, SETTINGS
from benchmarks.verification.mutations import MUTATIONS, ROOT, Mutation, apply, caught, copied, unchanged


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda m: m.name)
def test_a_mutation_fits_the_present_source(mutation):
    """Its text is there, the wrong text is another, and its cases exist."""
    text = (ROOT / "diffuphy" / mutation.file).read_text(encoding="utf-8")
    assert mutation.right in text and mutation.wrong != mutation.right
    assert mutation.scheme in SETTINGS and set(mutation.cases) <= set(CASES)


def test_a_text_that_is_gone_is_an_error(tmp_path):
    """A mutation that no longer applies would otherwise look as if it had been survived, or caught."""
    copied(tmp_path)
    with pytest.raises(ValueError, match=r"mutation 'gone': mpm/substep/kernels.py has no 'nowhere'"):
        apply(Mutation("gone", "mpm/substep/kernels.py", "nowhere", "", ("A1",)), tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_without_a_mistake_its_cases_pass():
    assert unchanged()


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda m: m.name)
def test_a_mistake_is_noticed(mutation):
    assert caught(mutation)
