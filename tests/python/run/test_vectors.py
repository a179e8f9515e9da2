"""The package against numbers that were computed with 60 digits (tests/data).

Every system is made from the formulas that stand beside the numbers, which are differentiated
here, and a second time as the library's own where it has one.
"""

import ast
import functools
import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from conftest import U, relative_residual

import dalembert as dal

# The sub-steps of a composition with h = 1/4 are large for the potential of generic4.
pytestmark = pytest.mark.filterwarnings("ignore:.*the full Newton:dalembert.DalembertWarning")

DATA = Path(__file__).parents[2] / "data"
VECTORS = json.loads((DATA / "vectors.json").read_text(encoding="ascii"))

BUILTIN = {
    "particle": "particle",
    "particle_osc": "particle_oscillator",
    "knife": "knife_edge",
    "sleigh": "sleigh",
    "disk": "disk",
    "heis": "heisenberg",
}
NAMES = list(VECTORS["systems"])
SUBJECTS = [(name, "formulas") for name in NAMES] + [(name, "built in") for name in BUILTIN]

# Of the largest component of a vector, or of 1: the data are rounded when they are read, and so is
# each operation of the longest runs, some hundred one after the other; 1e-13 is 900 u.
TOLERANCE = 1e-13


# ---- formulas ------------------------------------------------------------------------------


def derivative(formula, x):
    """Return d(formula)/dx, as a formula, of a polynomial in coordinates, sines and cosines."""

    def d(e):
        match e:
            case ast.Constant():
                return "0"
            case ast.Name(id=name):
                return "1" if name == x else "0"
            case ast.UnaryOp(op=ast.USub(), operand=a):
                return f"-({d(a)})"
            case ast.BinOp(left=a, op=ast.Add(), right=b):
                return f"({d(a)}) + ({d(b)})"
            case ast.BinOp(left=a, op=ast.Sub(), right=b):
                return f"({d(a)}) - ({d(b)})"
            case ast.BinOp(left=a, op=ast.Mult(), right=b):
                return f"({d(a)}) * ({ast.unparse(b)}) + ({ast.unparse(a)}) * ({d(b)})"
            case ast.BinOp(left=a, op=ast.Div(), right=ast.Constant(value=k)):
                return f"({d(a)}) / {k}"
            case ast.BinOp(left=a, op=ast.Pow(), right=ast.Constant(value=k)):
                return f"{k} * ({ast.unparse(a)}) ** {k - 1} * ({d(a)})"
            case ast.Call(func=ast.Name(id="sin"), args=[a]):
                return f"cos({ast.unparse(a)}) * ({d(a)})"
            case ast.Call(func=ast.Name(id="cos"), args=[a]):
                return f"-sin({ast.unparse(a)}) * ({d(a)})"
        raise ValueError(f"no rule for {ast.unparse(e)}")

    return d(ast.parse(formula, mode="eval").body)


class Formulas:
    """The functions of a system of the data: mu, V, M, b and their derivatives at a q."""

    def __init__(self, entry):
        self.names = entry["coordinates"]
        self.values = {
            "__builtins__": {},
            "sin": np.sin,
            "cos": np.cos,
            **{name: float(Fraction(text)) for name, text in entry["params"].items()},
        }
        self.constant_mass = entry["constant_mass"]
        self.M = self.array(entry["mass_matrix"])
        self.M_q = self.array(self.gradients_of(entry["mass_matrix"]))
        self.M_qq = self.array(self.gradients_of(self.gradients_of(entry["mass_matrix"])))
        self.b = self.array(entry["b"])
        self.b_q = self.array(self.gradients_of(entry["b"]))
        self.b_qq = self.array(self.gradients_of(self.gradients_of(entry["b"])))
        self.mu = self.array(entry["mu"])
        self.mu_q = self.array(self.gradients_of(entry["mu"]))
        self.V = self.array(entry["V"])
        self.V_q = self.array(self.gradients_of(entry["V"]))
        self.V_qq = self.array(self.gradients_of(self.gradients_of(entry["V"])))
        self.forces = entry["V"] != "0"

    def gradients_of(self, formula):
        """Return a formula, or an array of them, with its gradients as the last axis."""
        if isinstance(formula, list):
            return [self.gradients_of(f) for f in formula]
        return [derivative(formula, x) for x in self.names]

    def array(self, formulas):
        """Return the function of q whose value is the array of the values of the formulas."""
        text = str(formulas).replace("'", "")
        code = compile(ast.parse(text, mode="eval"), "vectors.json", "eval")
        return lambda q: np.array(
            eval(code, self.values, dict(zip(self.names, q, strict=False))), dtype=float
        )

    def system(self, constrained=True):
        """Return the System, if wanted without its constraints."""
        arguments = {"coordinates": self.names}
        if not self.constant_mass:
            arguments |= {
                "lagrangian": lambda q, v: v @ self.M(q) @ v / 2 + self.b(q) @ v - self.V(q),
                "lagrangian_q": lambda q, v: (
                    np.einsum("ijk,i,j->k", self.M_q(q), v, v) / 2 + v @ self.b_q(q) - self.V_q(q)
                ),
                "lagrangian_v": lambda q, v: self.M(q) @ v + self.b(q),
                "lagrangian_qq": lambda q, v: (
                    np.einsum("ijkl,i,j->kl", self.M_qq(q), v, v) / 2
                    + np.einsum("ikl,i->kl", self.b_qq(q), v)
                    - self.V_qq(q)
                ),
                "lagrangian_vq": lambda q, v: (
                    np.einsum("ikj,k->ij", self.M_q(q), v) + self.b_q(q)
                ),
                "lagrangian_vv": lambda q, v: self.M(q),
            }
        else:
            arguments["mass"] = self.M(np.zeros(len(self.names)))
        if self.constant_mass and self.forces:
            arguments |= {"potential": self.V, "gradient": self.V_q, "hessian": self.V_qq}
        if constrained:
            arguments |= {
                "forms": self.mu,
                "forms_velocity_derivative": lambda q, v: np.einsum("aij,i->aj", self.mu_q(q), v),
            }
        return dal.System(**arguments)


@functools.cache
def formulas(name):
    return Formulas(VECTORS["systems"][name])


@functools.cache
def system(name, kind):
    return dal.systems.get(BUILTIN[name]) if kind == "built in" else formulas(name).system()


# ---- comparisons ---------------------------------------------------------------------------


def number(text):
    return float(Fraction(text))


def array(values):
    return np.array(values, dtype=float)


def near(value, expected, more=0.0):
    expected = array(expected)
    tolerance = TOLERANCE * max(1.0, np.max(np.abs(expected), initial=0.0)) + more
    np.testing.assert_allclose(value, expected, rtol=0.0, atol=tolerance)


def reaction_noise(name, h, q, v):
    """Roundoff of kappa/h for the solution kappa of C kappa = -mu w: n u |M v| / (|h| |mu|)."""
    own = formulas(name)
    least = np.min(np.max(np.abs(own.mu(q)), axis=1))
    return 4 * len(q) * U * np.max(np.abs(own.M(q) @ v)) / (abs(h) * least)


def residual(name, q, v):
    """See `relative_residual`; with the mu and the M of the data."""
    own = formulas(name)
    return relative_residual(own.M(q), own.mu(q), v)


def scheme_of(entry):
    """Return the record of an entry and what `integrate` has to be told about its nodes."""
    if "data" in entry:
        return dal.Scheme([(number(entry["beta"]), 1.0)], nodes="kept"), {"initial": entry["data"]}
    if entry.get("scheme", "beta") == "beta":
        return dal.Scheme([(number(entry["beta"]), 1.0)]), {}
    mirror = {"strang01": "leapfrog", "strang10": "leapfrog-mirror"}
    return dal.Scheme.find(mirror.get(entry["scheme"], f"midpoint-{entry['scheme']}")), {}


def entries(group, name):
    found = [entry for entry in VECTORS[group] if entry["system"] == name]
    assert found
    return found


def integrate(subject, entry, **options):
    scheme, nodes = scheme_of(entry)
    return dal.integrate(
        subject,
        scheme,
        array(entry["q"]),
        array(entry["v"]),
        h=number(entry["eps"]),
        steps=entry.get("steps", 1),
        consistent="assume",
        **nodes,
        **options,
    )


# ---- tests ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "kind"), SUBJECTS)
def test_continuous(name, kind):
    """E, C, lambda and the acceleration on D and off it, f_v, the projection onto D."""
    subject = system(name, kind)
    without_constraints = formulas(name).system(constrained=False)
    for entry in entries("continuous", name):
        q, v = array(entry["q"]), array(entry["v"])
        near(subject.metric(q), entry["mass"])
        near(subject.energy(q, v), entry["energy"])
        near(subject.gram(q), entry["C"])
        near(subject.multipliers(q, v), entry["lambda"])
        near(subject.acceleration(q, v), entry["vdot"])
        near(subject.field(q, v), entry["v"] + entry["vdot"])
        near(without_constraints.acceleration(q, v), entry["f_v"])
        off = entry["off_D"]
        v = array(off["v"])
        near(subject.residual(q, v), array(entry["mu"]) @ v)
        near(subject.multipliers(q, v), off["lambda"])
        near(subject.acceleration(q, v), off["vdot"])
        near(subject.project(q, v), off["projected_v"])


@pytest.mark.parametrize("name", NAMES)
def test_formulas(name):
    """What this test makes of the formulas agrees with the data and with their differences."""
    own = formulas(name)
    for entry in entries("continuous", name):
        q, v = array(entry["q"]), array(entry["v"])
        near(own.mu(q), entry["mu"])
        near(np.einsum("aij,i,j->a", own.mu_q(q), v, v), entry["gamma"])
        assert system(name, "formulas").check(q, v)


@pytest.mark.parametrize("group", ["onestep", "multistep", "hat", "composition"])
@pytest.mark.parametrize(("name", "kind"), SUBJECTS)
def test_steps(name, kind, group):
    """Steps and runs: states, reactions, multipliers, energy, and D or D_eps at every state."""
    subject = system(name, kind)
    for entry in entries(group, name):
        run = integrate(subject, entry)
        q, v = run.q[-1], run.v[-1]
        near(q, entry["q1"])
        near(v, entry["v1"])
        own = entry.get("lambda", entry.get("lambda_mean"))
        if own is not None:
            near(run.reactions[-1], own, reaction_noise(name, run.h, q, v))
        if "lambda_consistent" in entry:
            near(run.multipliers[-1], entry["lambda_consistent"])
        if "energy1" in entry:
            near(run.energy[-1], entry["energy1"])
        for q, v in zip(run.q[1:], run.v[1:], strict=True):
            assert residual(name, q - run.shift * v, v) <= 4 * subject.n * U


@pytest.mark.parametrize("name", NAMES)
def test_unconstrained(name):
    """The beta-schemes without constraints."""
    subject = formulas(name).system(constrained=False)
    assert subject.m == 0
    for entry in entries("unconstrained", name):
        run = integrate(subject, entry)
        near(run.q[-1], entry["q1"])
        near(run.v[-1], entry["v1"])
        assert run.reactions.shape == (1, 0)


@pytest.mark.parametrize(("name", "kind"), SUBJECTS)
def test_projection(name, kind):
    """From D to D_eps along M^-1 mu^T."""
    for entry in entries("projection", name):
        q, v = array(entry["q"]), array(entry["v"])
        shift = (1 - number(entry["beta"])) * number(entry["eps"])
        projected = system(name, kind).project(q, v, shift=shift)
        near(projected, entry["v1"])
        assert residual(name, q - shift * projected, projected) <= 4 * len(q) * U


@pytest.mark.parametrize(("name", "kind"), SUBJECTS)
def test_ehresmann(name, kind):
    """A, B, psi and the multipliers of [A, I] for a choice of dependent coordinates."""
    subject = system(name, kind)
    for entry in entries("ehresmann", name):
        q = array(entry["q"])
        dependent = [subject.coordinates[i] for i in entry["dependent"]]
        chart = dal.Chart(subject, q, dependent=dependent)
        near(chart.A(q), entry["A"])
        near(chart.B(q), entry["B"])
        _, v = chart.lift([*q, *array(entry["v_ind"])])
        near(v[entry["independent"]], entry["v_ind"])
        near(v[entry["dependent"]], entry["v_dep"])
        near(subject.multipliers(q, v), entry["lambda"])
        near(chart.multipliers(q, v), entry["lambda_E"])
        near(chart.multipliers_back(q, v, array(entry["lambda_E"])), entry["lambda"])
