"""Some models of the campaign of derivatives; the campaign itself has hundreds, and larger ones."""

import sys
from pathlib import Path

import mpmath
import numpy as np
import pytest
import sympy

import dalembert as dal

sys.path.insert(0, str(Path(__file__).parents[3] / "benchmarks/campaigns"))
import derivatives  # noqa: E402


@pytest.mark.parametrize("seed, kind, mass", [(11, "affine", False), (1, "nonlinear", True)])
def test_derivatives_of_random_models(seed, kind, mass, monkeypatch):
    """Twelve models are one system, and an entry that belongs to two of them is 0; one is alone."""
    systems, system_of = [], derivatives.system_of
    monkeypatch.setattr(
        derivatives, "system_of", lambda parts: systems.append(system_of(parts)) or systems[-1]
    )
    found = derivatives.campaign(12, seed, size=12, depth=1, alone=1)
    assert not found.wrong and not found.failed
    assert found.count > 300 and 0 < found.worst < derivatives.BAR
    assert [s.n > 8 for s in systems] == [True, False]
    assert {(s.kind, s.has_constant_mass) for s in systems} == {(kind, mass)}


def test_what_differences_tell():
    """Values, gradient and Hessian of x^3 sin(y) + max(0, y), and an entry that is wrong."""
    x, y = dal.coordinates("x y")
    at = [0.3, 0.7]
    with mpmath.workdps(derivatives.DIGITS):
        e = x**3 * sympy.sin(y) + sympy.Max(0, y)
        found = derivatives.Differences(e, [x, y], at, {})
        value, gradient, hessian = found.values
        s, c = mpmath.sin(0.7), mpmath.cos(0.7)
        cube = mpmath.mpf(0.3) ** 3
        expected = [[6 * mpmath.mpf(0.3) * s, 3 * mpmath.mpf(0.3) ** 2 * c], [0, -cube * s]]
        expected[1][0] = expected[0][1]
        assert abs(value - cube * s - mpmath.mpf(0.7)) < 1e-60
        assert abs(gradient[1] - cube * c - 1) < 1e-60
        assert all(abs(hessian[i, j] - expected[i][j]) < 1e-60 for i in (0, 1) for j in (0, 1))
        size = found.sizes[2][0, 1]
        right = float(hessian[0, 1])
        for got, large in ((right, False), (right * (1 + 1e-12), True), (np.nan, True)):
            error = derivatives.Entry("", got, hessian[0, 1], size).error
            assert (not error <= derivatives.BAR) == large
        with pytest.raises(derivatives.Unsuitable, match="near a wall"):
            derivatives.Differences(sympy.Max(0, x - y), [x, y], [0.7, 0.7], {})
