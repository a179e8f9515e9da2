"""Runs that keep the energy."""

import numpy as np
import pytest
import sympy as sp

import dalembert as dal
from dalembert import cli
from dalembert.core import residual_bound
from dalembert.system import twins

x, y, z = dal.coordinates("x y z")
MASSES = (x.d**2 + y.d**2 + z.d**2) / 2
CONTACT = [z.d - y * x.d]
START = {"q0": [0.5, 0.3, -0.2], "v0": [1, 0.7, 0.3]}
QUARTIC = dal.System.from_sympy(MASSES - (x**4 + 2 * y**4 + z**4) / 4, CONTACT, **START)
SPRINGS = (x**2 + 2 * y**2 + sp.Rational(3, 2) * z**2) / 2
GYROSCOPIC = dal.System.from_sympy(MASSES - SPRINGS + x**2 * z.d, CONTACT, **START)
CURVED = dal.System.from_sympy(
    (x.d**2 * (2 + sp.cos(y)) + y.d**2 + z.d**2 * (1 + x**2)) / 2 - SPRINGS, CONTACT, **START
)
PENDULUM = dal.System.from_sympy(x.d**2 / 2 + sp.cos(x), [], q0=[1], v0=[0])
CONTACT_OSCILLATOR = dal.systems.contact_oscillator()


def runs(system, scheme, h, steps):
    """Return the runs without and with the energy kept."""
    return [dal.integrate(system, scheme, h=h, steps=steps, energy=e) for e in (None, "keep")]


@pytest.mark.parametrize(
    ("system", "scheme", "h", "steps", "drifts"),
    [
        (QUARTIC, "bm6", 0.25, 8000, 1e-8),
        (CONTACT_OSCILLATOR, "leapfrog", 0.1, 20000, 1e-3),
        (GYROSCOPIC, "leapfrog-kl8", 0.4, 5000, 1e-6),
        (CURVED, "leapfrog", -0.05, 5000, 1e-5),
    ],
)
def test_it_is_kept_over_long_times(system, scheme, h, steps, drifts):
    plain, kept = runs(system, scheme, h, steps)
    assert np.ptp(plain.energy) > drifts
    assert np.ptp(kept.energy) < 1e-14
    assert kept.residual.max() <= min(kept.stats.worst_residual, residual_bound(system.n))
    assert kept.stats.scaled == steps
    assert kept.stats.unscaled == kept.stats.jump_step == 0
    calls = kept.stats.constraint_calls, plain.stats.constraint_calls
    assert calls[0] < 2.01 * calls[1]
    assert "energy kept" in repr(kept)
    assert "energy" not in repr(plain)


def test_what_else_is_conserved_stays_in_a_band():
    plain, kept = runs(QUARTIC, "bm6", 0.25, 40000)
    errors = [abs((r.v[:, 1] ** 2 + r.q[:, 1] ** 4) / 2 - 0.24905) for r in (plain, kept)]
    assert errors[0][0] < 1e-15
    assert errors[1].max() < 2 * errors[1][:4000].max() < 1e-6


def test_the_scheme_keeps_its_order():
    exact = dal.integrate(CURVED, "reference", h=1, steps=4).x[-1]
    for scheme, h, order in (("leapfrog", 0.05, 2), ("leapfrog-suzuki4", 0.2, 4), ("bm6", 0.4, 6)):
        errors = [
            abs(dal.integrate(CURVED, scheme, h=h / k, t_end=4, energy="keep").x[-1] - exact).max()
            for k in (1, 2)
        ]
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.4)


@pytest.mark.parametrize("given", [{"h": "auto", "tolerance": 1e-9}, {"h": "reversible"}])
def test_steps_of_any_size_keep_it(given, tmp_path):
    given = {"scheme": "leapfrog-kl8", "t_end": 4, "energy": "keep", **given}
    run = dal.integrate(CURVED if given["h"] == "auto" else QUARTIC, **given)
    exact = dal.integrate(run.system, "reference", h=1, steps=4).x[-1]
    assert run.stats.scaled > 0 and abs(run.x[-1] - exact).max() < 1e-6
    assert abs(run.energy - run.energy[0]).max() < 1e-14 * max(1, abs(run.energy[0]))
    part = dal.integrate(run.system, **{**given, "t_end": 2}, journal=tmp_path / "run.dal")
    assert part.t[-1] == 2
    at = dal.integrate(run.system, **given, t_eval=[1.2345, 3.9])
    assert abs(at.energy - run.energy[0]).max() < 1e-14 * max(1, abs(run.energy[0]))


def test_a_run_that_cannot_keep_it_says_so():
    with pytest.warns(dal.DalembertWarning, match=r"not kept in \d+ of 2000 steps"):
        run = dal.integrate(PENDULUM, h=0.5, steps=2000, energy="keep")
    assert 0 < run.stats.unscaled < 200
    assert f"except in {run.stats.unscaled} of 2000 steps" in repr(run)
    lost = (abs(run.energy - run.energy[0]) > 1e-14).sum()
    assert lost == run.stats.unscaled
    with pytest.warns(dal.DalembertWarning, match="would have changed"):
        dal.integrate(PENDULUM, h=1.5, steps=200, energy="keep", check_h=False)


def test_states_between_steps_and_at_events_that_cannot_keep_it_are_counted():
    given = {"q0": [0], "v0": [1], "h": 0.1, "steps": 100, "energy": "keep"}
    run = dal.integrate(PENDULUM, t_eval=[0.5001, 2.345], **given)
    assert np.ptp(run.energy) < 1e-15
    assert run.stats.unscaled == 0
    with pytest.warns(dal.DalembertWarning, match="energy was not kept"):
        turns = dal.integrate(PENDULUM, events=[lambda t, q, v: v[0]], **given)  # T is 0 there
    assert 0 < turns.stats.unscaled <= len(turns.t_events[0])
    assert np.ptp(turns.energy) < 1e-15


def test_a_reset_is_a_new_start():
    def hit(t, q, v):
        return q[0] - 0.9

    hit.direction = 1
    hit.reset = lambda q, v: (q, -0.9 * v)
    run = dal.integrate(QUARTIC, h=0.1, steps=300, energy="keep", events=[hit])
    energies = [run.energy[0]]
    energies += [QUARTIC.energy(*state) for state in zip(run.q_after[0], run.v_after[0])]
    assert len(energies) > 3
    since = np.searchsorted(run.t_events[0], run.t)
    assert abs(run.energy - np.array(energies)[since]).max() < 1e-14


def test_a_stepper_makes_the_same_bits():
    run = dal.integrate(CURVED, "leapfrog-suzuki4", h=0.2, steps=50, energy="keep")
    stepper = dal.Stepper(CURVED, "leapfrog-suzuki4", h=0.2, energy="keep")
    stepper.step(steps=20)
    other = dal.Stepper(CURVED, "leapfrog-suzuki4", h=0.2, energy="keep")
    other.restore(stepper.save())
    other.step(steps=30)
    assert (other.x == run.x[-1]).all()
    with pytest.raises(ValueError, match="keep_energy = 1; expected 0"):
        dal.Stepper(CURVED, "leapfrog-suzuki4", h=0.2).restore(stepper.save())
    stepper.reset([0.1, 0.2, 0.3], [1, 1, 0.2])
    energy = stepper.energy
    stepper.step(steps=30)
    assert stepper.energy == pytest.approx(energy, abs=1e-14)


def test_a_journal_goes_on_with_it(tmp_path):
    path = tmp_path / "run.dal"
    whole = dal.integrate(QUARTIC, h=0.1, steps=200, energy="keep")
    dal.integrate(QUARTIC, h=0.1, steps=80, energy="keep", journal=path)
    run = dal.resume(path, QUARTIC, steps=200)
    assert (run.x == whole.x).all()
    assert run.stats == whole.stats


@pytest.mark.parametrize("how", [{}, {"threads": 1, "lanes": True}, {"keep": "all"}])
def test_an_ensemble_has_the_bits_of_its_members(tmp_path, how):
    given = {"h": [0.1, 0.05], "steps": 100, "energy": "keep", "progress": False}
    many = dal.ensemble(CONTACT_OSCILLATOR, store=tmp_path / "store", **given, **how)
    for k, h in enumerate(given["h"]):
        run = dal.integrate(CONTACT_OSCILLATOR, h=h, steps=100, energy="keep")
        end = many.q[k][-1] if "keep" in how else many.q[k]
        assert (end == run.q[-1]).all()
        assert (many.member(k).x == run.x).all()
    again = dal.open_ensemble(tmp_path / "store")
    assert (again.member(0).x == many.member(0).x).all()


def test_an_ensemble_of_a_system_with_lanes_takes_none_of_them():
    twin = twins.twin(QUARTIC, "lanes")
    given = {"h": 0.1, "steps": 100, "energy": "keep"}
    many = dal.ensemble(
        twin, q0=[QUARTIC.q0] * 8, v0=[QUARTIC.v0] * 8, lanes=True, progress=False, **given
    )
    assert (many.q == dal.integrate(QUARTIC, **given).q[-1]).all()


def test_members_that_cannot_keep_it_are_doubtful():
    many = dal.ensemble(PENDULUM, h=[0.1, 0.5], steps=500, energy="keep", progress=False)
    assert many.doubtful.tolist() == [False, True]


def test_the_command_has_it(capsys):
    words = ["run", "contact_oscillator", "--h", "0.1", "--steps", "100", "--energy", "keep"]
    assert cli.main(words) == 0
    assert "energy kept" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("system", "scheme", "words"),
    [
        (QUARTIC, "explicit", "symmetric scheme"),
        (QUARTIC, "pair:0.5:0.5", "symmetric scheme"),
        (dal.System(mass=[1], force=lambda t, q, v: -v, q0=[1], v0=[0]), "leapfrog", "a force"),
        (dal.System.from_sympy(x.d**2 / 2 - x * dal.time, [], q0=[1], v0=[0]), "leapfrog", "time"),
        (dal.System.from_sympy(MASSES, [z.d - y * x.d - 1], q0=[0, 0, 0], v0=[1, 1, 1]),
         "leapfrog", "affine"),
        (dal.System.from_sympy(-sp.sqrt(1 - x.d**2), [], q0=[0], v0=[0.1]), "leapfrog",
         "quadratic in v"),
    ],
)  # fmt: skip
def test_refusals(system, scheme, words):
    with pytest.raises(NotImplementedError, match=words):
        dal.integrate(system, scheme, h=0.1, steps=1, energy="keep")


def test_refusals_of_arguments():
    with pytest.raises(ValueError, match="energy = 'keep': not used with .* kept nodes"):
        dal.integrate(QUARTIC, "midpoint-nodes", h=0.1, steps=1, energy="keep", initial="D")
    with pytest.raises(ValueError, match="energy = 'keep': not used with .*'reference'"):
        dal.integrate(QUARTIC, "reference", h=0.1, steps=1, energy="keep")
    for energy in ("kept", 1, True):
        with pytest.raises(ValueError, match="energy = "):
            dal.integrate(QUARTIC, h=0.1, steps=1, energy=energy)
        with pytest.raises(ValueError, match="energy = "):
            dal.ensemble(QUARTIC, h=0.1, steps=1, energy=energy)
    with pytest.raises(NotImplementedError, match="symmetric scheme"):
        dal.ensemble(QUARTIC, "explicit", h=0.1, steps=1, energy="keep", progress=False)
