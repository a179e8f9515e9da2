"""Units: what the user says of them travels with the system, and stands where it is drawn."""

from __future__ import annotations

import os
import pickle
import re

import numpy as np
import pytest
import sympy
from matplotlib import pyplot

import dalembert as dal

UNITS = {"x": "m", "y": "m", "theta": "rad", "t": "s", "energy": "J"}


@pytest.fixture(autouse=True)
def no_windows():
    yield
    pyplot.close("all")


@pytest.fixture(scope="module")
def sleigh():
    return dal.systems.sleigh().with_units(**UNITS)


@pytest.fixture(scope="module")
def run(sleigh):
    return dal.integrate(sleigh, h=0.05, steps=100)


def forms(q):
    return [[-q[1], 0, 1]]


def own(**units):
    return dal.System(
        mass=[1, 1, 1], mu=forms, coordinates="xyz", q0=[0, 1, 0], v0=[1, 1, 1], units=units
    )


def test_units_of_what_is_known():
    system = own(x="m", y="µm", t="s")
    assert system.units == {"x": "m", "y": "µm", "t": "s"}
    found = {name: system.unit(name) for name in ("x", "z", "v_x", "v_y", "v_z", "t", "energy")}
    assert found == {
        "x": "m", "z": "", "v_x": "m/s", "v_y": "µm/s", "v_z": "", "t": "s", "energy": "",
    }  # fmt: skip
    assert own(x="m").unit("v_x") == "" and own(t="s").unit("v_x") == ""
    assert own(x="m", t="10 s").unit("v_x") == "m/(10 s)"
    assert own().units == {} and own(x="m").unit("lambda_0") == ""
    system.units["x"] = "mm"
    assert system.units["x"] == "m"


def test_a_coordinate_that_is_called_as_a_velocity():
    system = dal.System(mass=[1, 1], coordinates=["x", "v_x"], units={"x": "m", "t": "s"})
    assert system.unit("v_x") == ""  # the coordinate
    with pytest.raises(ValueError, match="name = 1: expected a string"):
        system.unit(1)
    assert system.unit("v_v_x") == "" and system.with_units(v_x="kg").unit("v_x") == "kg"


@pytest.mark.parametrize(
    ("units", "text"),
    [
        ({"q": "m"}, "units: 'q' is unknown; expected some of x, y, z, t, energy"),
        ({"energi": "J"}, "did you mean 'energy'?"),
        ({3: "m"}, "units: 3 is unknown"),
        ({"x": 3}, r"units\['x'\] = 3: expected the name of a unit"),
        ({"x": ""}, r"units\['x'\] = ''"),
        ({"x": "m\ns"}, r"units\['x'\] = 'm\\ns'"),
        ({"x": None}, r"units\['x'\] = None"),
        (["m", "m", "m"], "units = .*: expected a mapping"),
    ],
)
def test_refused(units, text):
    with pytest.raises(ValueError, match=text):
        dal.System(mass=[1, 1, 1], coordinates="xyz", units=units)
    x, y, z = dal.coordinates("x y z")
    with pytest.raises(ValueError, match=text):
        dal.System.from_sympy((x.d**2 + y.d**2 + z.d**2) / 2, units=units)


def test_a_coordinate_that_is_called_as_the_time():
    with pytest.raises(ValueError, match="units: 't' is also a coordinate; expected some of x, en"):
        dal.System(mass=[1, 1], coordinates=["x", "t"], units={"t": "s"})


def test_units_travel(sleigh):
    x, y = dal.coordinates("x y")
    kinds = [
        sleigh,
        sleigh.with_parameters(a=0.3),
        sleigh.at_kept_nodes(0.1),
        sleigh.deformed(lambda q, v: [v[0]], 0.1, g_v=lambda q, v: [[1, 0, 0]]),
        pickle.loads(pickle.dumps(sleigh.with_parameters(a=0.3))),
        pickle.loads(pickle.dumps(sleigh.at_kept_nodes(0.1))),
    ]
    assert [kind.units for kind in kinds] == [UNITS] * len(kinds)
    assert pickle.loads(pickle.dumps(own(x="m"))).units == {"x": "m"}
    model = dal.System.from_sympy((x.d**2 + y.d**2) / 2, units={"x": "m"})
    assert model.units == pickle.loads(pickle.dumps(model)).units == {"x": "m"}
    assert model.with_units(x="mm", t="s").units == {"x": "mm", "t": "s"}
    assert model.units == {"x": "m"}  # as before
    assert dal.systems.sleigh().units == {}


def test_units_change_no_bit(sleigh, run):
    bare = dal.integrate(dal.systems.sleigh(), h=0.05, steps=100)
    np.testing.assert_array_equal(run.x, bare.x)


# ---- files ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["run.npz", "run.dal"])
def test_files(name, sleigh, run, tmp_path):
    path = os.fspath(tmp_path / name)
    if name == "run.dal":
        dal.integrate(sleigh, h=0.05, steps=100, journal=path)
    else:
        run.save(path)
    assert dal.load(path).system.units == UNITS
    assert dal.load(path, dal.systems.sleigh()).system.units == UNITS
    some = dal.load(path, dal.systems.sleigh().with_units(x="m"))
    assert some.system.units == UNITS and np.array_equal(some.x, run.x)
    with pytest.raises(ValueError, match="has x in m, but this system has it in mm"):
        dal.load(path, dal.systems.sleigh().with_units(x="mm"))


def test_a_file_without_units_gets_those_of_the_system(tmp_path):
    path = os.fspath(tmp_path / "run.npz")
    dal.integrate(dal.systems.sleigh(), h=0.05, steps=10).save(path)
    given = dal.systems.sleigh().with_units(x="mm")
    assert dal.load(path, given).system is given


def test_ensembles_keep_them(sleigh, tmp_path):
    path = os.fspath(tmp_path / "store")
    given = {"parameters": {"a": [0.1, 0.2]}, "h": 0.01, "steps": 10, "progress": False}
    dal.ensemble(sleigh, store=path, **given)
    assert dal.open_ensemble(path).system.units == UNITS
    dal.ensemble(dal.systems.sleigh(), store=path, **given)  # the same, whoever says the units
    with pytest.raises(ValueError, match="has t in s, but this system has it in h"):
        dal.ensemble(sleigh.with_units(t="h"), store=path, **given)


def test_a_table_of_pandas(run):
    frame = run.to_pandas()
    assert frame.attrs["units"] == {
        **UNITS, "v_x": "m/s", "v_y": "m/s", "v_theta": "rad/s",
    }  # fmt: skip


# ---- pictures ------------------------------------------------------------------------------------


def test_axes(sleigh, run):
    study = dal.convergence(sleigh, "midpoint", steps=(10, 15, 20))
    axes = {kind: dal.plot.convergence(study, quantity=kind) for kind in ("state", "q", "v")}
    assert all(ax.get_xlabel() == "step h (s)" for ax in axes.values())
    mixed = [f"error of {kind} at t = 1" for kind in ("(q, v)", "q", "v")]  # m and rad
    assert [ax.get_ylabel() for ax in axes.values()] == mixed
    flat = sleigh.with_units(theta="m")  # as if it were
    alike = dal.convergence(flat, "midpoint", steps=(10, 15, 20))
    found = [dal.plot.convergence(alike, quantity=kind).get_ylabel() for kind in ("q", "v")]
    assert [text.rsplit(" ", 1)[1] for text in found] == ["(m)", "(m/s)"]
    both = dal.plot.convergence([study, dal.convergence(sleigh.with_units(t="h"), "leapfrog")])
    assert both.get_xlabel() == "step h"  # two of them
    assert dal.plot.drift(run)[0].get_xlabel() == "time t (s)"
    assert dal.plot.energy(run).get_xlabel() == "time t (s)"
    assert "J" not in dal.plot.energy(run).get_ylabel()  # a ratio
    ax = dal.plot.path(run, coordinates=(0, 2))
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x (m)", "theta (rad)")


def test_axes_of_ensembles(sleigh):
    def many(**given):
        return dal.ensemble(sleigh, h=0.01, steps=20, progress=False, **given)

    ends = many(parameters={"a": [0.1, 0.2, 0.3]})
    ax = ends.plot("v_theta", y="x")
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("v_theta at the end (rad/s)", "x at the end (m)")
    assert ax.figure.axes[1].get_ylabel() == "a"
    bands = many(parameters={"a": [0.1, 0.2]}, keep="energy", stride=5).plot("energy")
    assert (bands.get_xlabel(), bands.get_ylabel()) == ("t (s)", "energy (J)")


def test_a_parameter_has_no_unit_of_another():
    x, y = dal.coordinates("x y")
    named = dal.System.from_sympy(
        sympy.Symbol("energy") * (x.d**2 + y.d**2) / 2, parameters={"energy": 1}, q0=[0, 0],
        v0=[1, 1], units={"energy": "J", "x": "m"},
    )  # fmt: skip
    many = dal.ensemble(named, parameters={"energy": [1, 2]}, h=0.1, steps=5, progress=False)
    ax = many.plot("x")
    assert ax.get_xlabel() == "x at the end (m)"
    assert ax.figure.axes[1].get_ylabel() == "energy"


def test_pages_and_reports(sleigh):
    text = dal.pages.page(sleigh.with_units(y="<b>$m$"))
    assert "<b>" not in text and "&lt;b&gt;" in text
    assert "leapfrog with h = 0.02 s to t = 20 s" in text
    assert re.search(r"x from 0 to \S+ m, between", text)
    assert "<td>0.3 rad</td>" in text and "<td>1 rad/s</td>" in text
    study = dal.studies(sleigh, ["midpoint"], steps=(10, 15, 20))
    words = dal.show.report.page(study)
    assert "They start at x = 0 m, y = 0 m, theta = 0.3 rad, v = (" in words
    assert "Numbers without a unit are in the units of the model." in words


def test_a_hostile_unit():
    ax = dal.plot.path(dal.integrate(own(x="<b>$m$", t='"s'), h=0.1, steps=5))
    assert ax.get_xlabel() == r"x (<b>\$m\$)"
    ax.figure.canvas.draw()
