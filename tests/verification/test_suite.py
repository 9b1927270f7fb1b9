"""Every case of ``benchmarks/verification`` stays within its interval; each states its equation in its docstring."""

import pytest
import torch

from benchmarks.verification import CASES, SETTINGS
from benchmarks.verification.report import run


def parameters() -> list:
    """Short cases under the default transfer; long ones, and the plain transfers, marked slow."""
    out = []
    for case in sorted(CASES.values(), key=lambda c: c.place):
        for name in SETTINGS:
            if name in case.schemes:
                slow = case.tier > 0 or name != "default"
                marks = [pytest.mark.slow, pytest.mark.timeout(1200)] if slow else []
                out.append(pytest.param(case.id, name, id=f"{case.id}-{name}", marks=marks))
    return out


@pytest.fixture(autouse=True)
def one_thread():
    """Small tensors: threads cost more than they bring."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize("id, scheme", parameters())
def test_measured_is_within_what_theory_accepts(id, scheme):
    result = run(id, SETTINGS[scheme])
    assert result.checks
    assert result.ok, "\n".join(["", *(str(c) for c in result.checks if not c.ok)])
